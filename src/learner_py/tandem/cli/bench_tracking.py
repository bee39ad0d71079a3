"""`tandem bench tracking`: how well the arm follows commands in free space, beside two other designs."""

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, write_json


def tracking(
    load: Annotated[
        float, typer.Option(help="N, weight of the load that the robot does not know.", min=0.1, max=10.0)
    ] = 2.0,
    json_file: JsonOption = None,
) -> None:
    """Error of the pose on a test path and after it, in free motion and with a load 100 mm beside the tool.

    Three designs: ours; commands that start from the measured pose; half the rotational stiffness. Simulated
    and deterministic. JSON: rows of variant, load_N, position_mm and rotation_mrad {rms, max, steady, delayed_rms}.
    """
    from tandem import processes, run_folder

    with tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        results = Path(name) / "tracking.json"
        command: processes.Command = [
            run_folder.program("tandem_bench_tracking"),
            *("--load", str(load), "--json", results),
        ]
        if sentence := processes.missing_program(command):
            fail(sentence)
        code = subprocess.run([str(word) for word in command], cwd=run_folder.ROOT).returncode
        if code != 0:
            raise typer.Exit(code)
        value = json.loads(results.read_text())
    value |= {"git_revision": run_folder.git_revision(), "host": run_folder.host()}
    write_json(json_file, value)
