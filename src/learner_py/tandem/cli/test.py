"""`tandem test [CTEST OPTIONS]`."""

import subprocess

import typer

from tandem.run_folder import ROOT


def test(context: typer.Context) -> None:
    """Build everything and run all tests (C++ and Python) under ctest.

    What follows is handed to ctest: -R REGEX runs tests by name, -L LABEL by label, -N lists them.
    """
    build = subprocess.run(["cmake", "--build", str(ROOT / "build")], cwd=ROOT)
    if build.returncode:
        raise typer.Exit(build.returncode)
    command = ["ctest", "--test-dir", str(ROOT / "build"), "--output-on-failure", *context.args]
    raise typer.Exit(subprocess.run(command, cwd=ROOT).returncode)
