"""Where the controller is to be found: shared by the commands that talk to a run which is going."""

import os
from pathlib import Path
from typing import Annotated

import typer

from tandem import run_folder
from tandem.cli.common import fail
from tandem.run_folder import RunFolder
from tandem.wire import DEFAULT_URL, Wire

LcmUrlOption = Annotated[
    str | None,
    typer.Option(
        help="LCM address [default: that of --run, else LCM_DEFAULT_URL, else that of the newest run that is going]."
    ),
]
RunOption = Annotated[
    Path | None,
    typer.Option("--run", metavar="DIR", help="Folder of the run [default: the newest that is going]."),
]


def find(lcm_url: str | None, run: Path | None) -> tuple[str, RunFolder | None]:
    """The address, and the run's folder when there is one."""
    if run is not None:
        folder = RunFolder(run.absolute())
        if not folder.path.is_dir():
            fail(f"{run} is not a run folder.", 2)
        if lcm_url:
            return lcm_url, folder
        try:
            return folder.lcm_url.read_text().strip(), folder
        except OSError:
            fail(
                f"{run} is not going now (it has no lcm_url); start it by ./tandem train, or give --lcm-url."
            )
    if url := lcm_url or os.environ.get("LCM_DEFAULT_URL"):
        return url, None
    going = sorted(run_folder.RUNS.glob("*/lcm_url"), key=lambda file: file.stat().st_mtime)
    if not going:
        return DEFAULT_URL, None
    return going[-1].read_text().strip(), RunFolder(going[-1].parent)


def connect(url: str) -> Wire:
    """@raises typer.Exit with a sentence when LCM does not open the address."""
    try:
        return Wire(url)
    except RuntimeError as error:
        fail(str(error))
