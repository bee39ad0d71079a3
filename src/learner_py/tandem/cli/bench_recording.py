"""`tandem bench recording`: whether a log has all of a run."""

import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json


def recording(
    task: Annotated[str, typer.Option(help="Task that the arm is at.")] = "peg",
    minutes: Annotated[float, typer.Option(help="Minutes of training that are recorded.", min=0.1)] = 10.0,
    json_file: JsonOption = None,
) -> None:
    """A training in real time at full rate (ROBOT_STATE at 1 kHz on the wire), recorded by its own log and by
    lcm-logger; messages lost, by the numbers that they carry. Needs about 1 GB below TMPDIR for 10 minutes.

    To reach: none lost, in either. Exit code 1 when the run's own log has a hole. JSON: seconds, own {bytes, messages,
    lost, event_numbers_missing, channels}, lcm_logger {bytes, lost, channels}, learner_updates_per_s, ticks, overruns,
    records_dropped, reached.
    """
    from tandem import recording_bench, run_folder

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        try:
            print("Demonstrations and the learner's start ...", flush=True)
            told = recording_bench.record(Path(name), task, minutes, lambda line: print(line, flush=True))
            value = recording_bench.count(told.pop("log"), told.pop("lcm_logger"))
        except recording_bench.RecordingBenchError as error:
            fail(str(error))
    own, foreign = value["own"], value["lcm_logger"]
    value |= {
        **told,
        "load_average": os.getloadavg()[0],
        "reached": {"own": own["lost"] + told["records_dropped"] == 0, "lcm_logger": foreign["lost"] == 0},
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    _print(value)
    write_json(json_file, value)
    if not value["reached"]["own"]:
        raise typer.Exit(1)


def _print(value: dict[str, Any]) -> None:
    own, foreign, host = value["own"], value["lcm_logger"], value["host"]
    print(
        f"{value['seconds']:.0f} s with the learner at {value['learner_updates_per_s']:.0f} updates/s;"
        f" {value['ticks']} ticks, {value['overruns']} overruns"
    )
    print(f"own log     {own['messages']} messages, {own['bytes'] / 1e6:.1f} MB")
    for name, channel in own["channels"].items():
        gaps = "no numbers" if channel["gaps"] is None else f"{channel['gaps']} missing"
        line = f"  {name:<18} {channel['count']:>9} {gaps}"
        if name in foreign["channels"]:
            there = foreign["channels"][name]
            line += f"; lcm-logger {there['in_lcm_logger']} of {there['in_log']}, {there['lost']} missing"
        print(line)
    lost = own["lost"] + value["records_dropped"]
    for reached, sentence in (
        (value["reached"]["own"], f"{lost} messages lost by the run's own log (target: 0)"),
        (value["reached"]["lcm_logger"], f"{foreign['lost']} of its messages lost by lcm-logger (target: 0)"),
    ):
        print(f"{'reached' if reached else 'MISSED '}  {sentence}")
    print(f"on {host['cpu']}, {host['cores']} cores, load {value['load_average']:.1f}, {host['system']}")
