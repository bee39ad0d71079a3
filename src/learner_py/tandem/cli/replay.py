"""`tandem replay LOG`."""

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, write_json


def replay(
    log: Annotated[Path, typer.Argument(help="log.lcm of a run, or the run's folder.")],
    episodes: Annotated[int, typer.Option(help="At most so many, from the first; 0 = all.", min=0)] = 0,
    json_file: JsonOption = None,
) -> None:
    """Compute a logged run again by the same code and compare every torque bit for bit.

    A lockstep log: the whole control side with the simulated arm, from the seeds, human commands, chunks and
    gains in the log. A real-time log: the control side, from the recorded states of the robot. Exit code 0:
    equal; 1: it differs, and where first; 2: not to be read, or no motion in it to compute again.
    """
    from tandem import processes, run_folder

    file = log / "log.lcm" if log.is_dir() else log
    if not file.is_file():
        fail(f"{file} does not exist; give a run's log.lcm or its folder.", 2)
    with tempfile.TemporaryDirectory(prefix="tandem-replay-") as folder:
        report = Path(folder) / "replay.json"
        program: processes.Command = [
            run_folder.program("tandem_replay"),
            file.absolute(),
            "--root",
            run_folder.ROOT,
            "--episodes",
            str(episodes),
            "--json",
            report,
        ]
        if sentence := processes.missing_program(program):
            fail(sentence)
        code = subprocess.run([str(word) for word in program]).returncode
        if report.is_file():
            write_json(json_file, json.loads(report.read_text()))
    raise typer.Exit(code)
