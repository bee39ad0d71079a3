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
    """A training in real time at full rate, recorded by its own log (CONTROL_TICK and ROBOT_STATE at 1 kHz) and by
    lcm-logger, which records two channels at 1 kHz of another program as well (twice: a second time with real-time
    priority, where that is allowed); messages lost, by the numbers that they carry. Needs about 2 GB below TMPDIR
    for 10 minutes.

    To reach: none lost. Exit code 1 when the run's own log has a hole. JSON: seconds, own {bytes, messages, lost,
    event_numbers_missing, channels}, others {name: {bytes, lost, channels}}, learner_updates_per_s, ticks, overruns,
    records_dropped, reached.
    """
    from tandem import recording_bench, run_folder

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        try:
            print("Demonstrations and the learner's start ...", flush=True)
            told = recording_bench.record(Path(name), task, minutes, lambda line: print(line, flush=True))
            value = recording_bench.count(told.pop("log"), told.pop("others"), told["sent_beside"])
        except recording_bench.RecordingBenchError as error:
            fail(str(error))
    own, others = value["own"], value["others"]
    value |= {
        **told,
        "load_average": os.getloadavg()[0],
        "reached": {
            "own": own["lost"] + told["records_dropped"] == 0,
            **{name: other["lost"] == 0 for name, other in others.items()},
        },
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    _print(value)
    write_json(json_file, value)
    if not value["reached"]["own"]:
        raise typer.Exit(1)


def _print(value: dict[str, Any]) -> None:
    own, others, host = value["own"], value["others"], value["host"]
    print(
        f"{value['seconds']:.0f} s with the learner at {value['learner_updates_per_s']:.0f} updates/s;"
        f" {value['ticks']} ticks, {value['overruns']} overruns"
    )
    print(f"own log     {own['messages']} messages, {own['bytes'] / 1e6:.1f} MB")
    for name, channel in own["channels"].items():
        gaps = "no numbers" if channel["gaps"] is None else f"{channel['gaps']} missing"
        print(f"  {name:<18} {channel['count']:>9}  {gaps}")
    sentences = {
        "own": f"{own['lost'] + value['records_dropped']} messages lost by the run's own log (target: 0)"
    }
    for name, other in others.items():
        print(f"{name}: {other['bytes'] / 1e6:.1f} MB")
        for channel, there in other["channels"].items():
            print(f"  {channel:<18} {there['recorded']:>9}  of {there['sent']}, {there['lost']} missing")
        sentences[name] = f"{other['lost']} messages lost by {name} (target: 0)"
    for name, sentence in sentences.items():
        print(f"{'reached' if value['reached'][name] else 'MISSED '}  {sentence}")
    print(f"on {host['cpu']}, {host['cores']} cores, load {value['load_average']:.1f}, {host['system']}")
