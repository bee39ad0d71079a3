"""What `table` and `ablate` share: options, carrying out the runs, showing what came out."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tandem.cli.common import fail, same_command, write_json

if TYPE_CHECKING:
    from tandem.experiments.report import Report
    from tandem.experiments.runs import Run

SeedsOption = Annotated[str, typer.Option(help="Training seeds, comma-separated.")]
JobsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=1024,
        help="Runs at a time, each on cores of its own [default: as many as there are cores].",
    ),
]
RayOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Run on Ray: local (an instance on this machine), auto or HOST:PORT (a cluster whose machines see"
        " this tree and the run folders under the same paths).",
    ),
]
CollectOption = Annotated[bool, typer.Option("--collect-only", help="Train nothing; show the finished runs.")]
PaperOption = Annotated[
    bool,
    typer.Option(
        "--paper",
        help="Show the paper's own conventions too: the best checkpoint's own episodes, training steps = updates, time"
        " zero at the first checkpoint.",
    ),
]
ReportOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Write report.md, report.csv and their pictures to DIR."),
]


def seed_numbers(seeds: str) -> list[int]:
    try:
        numbers = [int(seed) for seed in seeds.split(",")]
    except ValueError:
        fail(f"--seeds is {seeds!r}; it must be whole numbers with commas between, e.g. 0,1,2.", 2)
    if len(set(numbers)) < len(numbers):
        fail(f"--seeds is {seeds!r}; a seed is given twice.", 2)
    return numbers


def carry_out(runs: "Sequence[Run]", jobs: int | None, ray: str | None) -> list[str]:
    """Trains what is not finished. Returns a sentence for each run that failed; ends the command when stopped."""
    from tandem.experiments import machines, runner
    from tandem.experiments.runs import check
    from tandem.processes import interruptible

    check(runs)
    if all(run.finished for run in runs):
        return []

    def say(line: str) -> None:
        # The terminal may be gone; the runs end in good order all the same.
        with contextlib.suppress(OSError):
            print(line, flush=True)

    try:
        machine: machines.Machine = machines.RayMachine(ray, jobs) if ray else machines.ThisMachine(jobs)
    except machines.MachineError as error:
        fail(str(error), 2)
    try:
        with interruptible() as interrupted:
            at_a_time = jobs or machine.cores
            outcome = runner.spread(runs, machine, at_a_time, say, interrupted)
    finally:
        machine.close()
    if outcome.stopped:
        say(f"Stopped; nothing is lost. To go on:\n  {same_command()}")
        raise typer.Exit(130)
    return outcome.failed


def show(
    report: "Report",
    facts: Mapping[str, object],
    failed: Sequence[str],
    report_folder: Path | None,
    markdown: Path | None,
    json_file: Path | None,
) -> None:
    """Tables on the terminal, files where asked; ends with exit code 1 when runs failed."""
    from rich.console import Console

    from tandem.run_folder import shown

    # Files first: whoever reads the terminal may be gone after hours of training.
    written: list[Path] = []
    try:
        if report_folder is not None:
            written = report.write(report_folder)
        if markdown is not None:
            markdown.write_text(report.markdown(), encoding="utf-8")
    except OSError as error:
        fail(f"{error.filename} can't be written ({error.strerror}).")
    paper = {"paper": report.paper_rows} if report.paper_rows else {}
    write_json(json_file, {**facts, "rows": report.rows, **paper, "failed": list(failed)})
    console = Console()
    for table in report.tables():
        console.print(table)
    if report_folder is not None:
        console.print(f"{shown(report_folder)}: {', '.join(file.name for file in written)}", soft_wrap=True)
    if failed:
        print(f"{len(failed)} runs failed:\n" + "\n".join(f"  {sentence}" for sentence in failed), flush=True)
        print(f"What is finished stays; to try them again:\n  {same_command()}", flush=True)
        raise typer.Exit(1)
