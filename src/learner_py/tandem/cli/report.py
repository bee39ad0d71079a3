"""`tandem report`."""

from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import fail, sentences


def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run, finished or not.")],
) -> None:
    """Write RUN/report.html anew: curves, figures, where the scenario differs from the default, on one page.

    A browser needs nothing else to show it. `train` writes it at the end of every run.
    """
    from tandem import run_report
    from tandem.run_folder import RunFolder, shown

    if not run.is_dir():
        fail(f"{run} is not a run folder.", 2)
    with sentences():
        try:
            page = run_report.write(RunFolder(run.absolute()))
        except OSError as error:
            fail(f"{error.filename or run} can't be written ({error.strerror}).")
    print(f"{shown(page)}: {page.stat().st_size / 1e3:.0f} kB")
