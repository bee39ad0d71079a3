"""`tandem table TASK`: methods x seeds."""

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


def table(
    task: Annotated[str, typer.Argument(help="Task: a file of config/tasks, e.g. peg.")],
    methods: Annotated[
        str, typer.Option(help="Methods, comma-separated [default: all that have a finished run].")
    ] = "",
    seeds: SeedsOption = "0,1,2",
    runs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run folders [default: runs].")
    ] = None,
    jobs: JobsOption = None,
    ray: RayOption = None,
    collect_only: CollectOption = False,
    paper: PaperOption = False,
    report: ReportOption = None,
    markdown: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the table as Markdown to FILE.")
    ] = None,
    overrides: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Compare methods: trains what is missing, a few runs at a time; success with Wilson intervals.

    Success is of fresh seeds, pooled over training seeds; `selected` is each run's best checkpoint, `last`
    its last one. Ctrl-C at any moment; the same command goes on and repeats nothing that is finished.
    """
    from tandem import run_folder
    from tandem.experiments import figures
    from tandem.experiments.report import Report
    from tandem.experiments.runs import Run, typed

    folder = (runs or run_folder.RUNS).absolute()
    with sentences():
        numbers = seed_numbers(seeds)
        wanted = [name.strip() for name in methods.split(",") if name.strip()] or _finished_methods(
            folder, task
        )
        if not wanted:
            fail(
                f"no run of {task} below {run_folder.shown(folder)} is finished; name --methods to train,"
                " e.g. --methods tandem,mcbc.",
                2,
            )
        asked = [
            Run(method, task, method, seed, run_folder.RunFolder(folder / name), typed(overrides))
            for seed in numbers
            for method in dict.fromkeys(wanted)
            for name in [f"{task}-{method}-seed{seed}"]
        ]
        failed = [] if collect_only else carry_out(asked, jobs, ray)
        results = figures.collect(asked)
        in_order = {method: results[method] for method in wanted if method in results}
        value = Report(f"Task {task}", "method", in_order, with_paper=paper)
    show(value, {"task": task}, failed, report, markdown, json_file)


def _finished_methods(folder: Path, task: str) -> list[str]:
    found = set()
    for file in folder.glob(f"{task}-*-seed*/summary.json"):
        found.add(file.parent.name[len(task) + 1 :].rsplit("-seed", 1)[0])
    return sorted(found)
