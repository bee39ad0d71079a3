"""`tandem ablate NAME`: the variants of config/ablations/NAME.yaml x seeds."""

from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences
from tandem.cli.experiment import (
    CollectOption,
    JobsOption,
    PaperOption,
    RayOption,
    ReportOption,
    SeedsOption,
    carry_out,
    seed_numbers,
    show,
)


def ablate(
    name: Annotated[str | None, typer.Argument(help="A file of config/ablations, e.g. critic.")] = None,
    seeds: SeedsOption = "0,1,2",
    runs: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the run folders [default: runs/ablations/NAME]."),
    ] = None,
    variants: Annotated[
        str | None,
        typer.Option(metavar="LABELS", help="Only these variants, comma-separated [default: all]."),
    ] = None,
    jobs: JobsOption = None,
    ray: RayOption = None,
    collect_only: CollectOption = False,
    listed: Annotated[bool, typer.Option("--list", help="List the ablations and their variants.")] = False,
    paper: PaperOption = False,
    report: ReportOption = None,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Answer a question by variants of a method: trains what is missing, then shows the same table as `table`.

    Ctrl-C at any moment; the same command goes on and repeats nothing that is finished.
    """
    from tandem.experiments import ablation, figures
    from tandem.experiments.report import Report
    from tandem.experiments.runs import typed
    from tandem.run_folder import shown

    with sentences():
        if listed:
            _list()
            return
        if name is None:
            fail(f"name one of the ablations: {', '.join(ablation.names())}; --list says what they ask.", 2)
        chosen = ablation.load(name)
        if variants is not None:
            chosen = chosen.only(variants.split(","))
        folder = (runs or ablation.FOLDER / name).absolute()
        asked = chosen.runs(folder, seed_numbers(seeds), typed(overrides))
        failed = [] if collect_only else carry_out(asked, jobs, ray)
        results = figures.collect(asked)
        if not results and not failed:
            fail(
                f"no run of {name} below {shown(folder)} is finished; leave out --collect-only to train them.",
                2,
            )
        in_order = {v.label: results[v.label] for v in chosen.variants if v.label in results}
        value = Report(chosen.title, "variant", in_order, chosen.question, with_paper=paper)
    facts = {"ablation": name, "question": chosen.question, "task": chosen.task}
    show(value, facts, failed, report, None, json_file)


def _list() -> None:
    from tandem.experiments import ablation

    for name in ablation.names():
        found = ablation.load(name)
        print(f"{name:<16}{found.question}\n{'':<16}{', '.join(v.label for v in found.variants)}")
