"""`tandem export FORMAT LOG`: event logs for the tools that people already like."""

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json


class Format(StrEnum):
    lerobot = "lerobot"
    mcap = "mcap"
    rerun = "rerun"
    csv = "csv"
    parquet = "parquet"


SUFFIX = {
    Format.lerobot: "-lerobot",
    Format.mcap: ".mcap",
    Format.rerun: ".rrd",
    Format.csv: ".csv",
    Format.parquet: ".parquet",
}


def export(
    kind: Annotated[
        Format,
        typer.Argument(
            metavar="FORMAT",
            help="lerobot: LeRobotDataset v3.0 (a folder); mcap: for Foxglove and PlotJuggler; rerun: .rrd with the"
            " arm in 3D; csv, parquet: a table of policy steps, or of one channel.",
        ),
    ],
    log: Annotated[Path, typer.Argument(help="Event log, or a run folder.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="File or folder to make [default: beside the log, named after it]."
        ),
    ] = None,
    episodes: Annotated[
        str, typer.Option(metavar="N-M,...", help="Only these episodes, e.g. 3-10,15 [default: all].")
    ] = "",
    phase: Annotated[
        str, typer.Option(help="Only episodes of this phase: demonstration, training or evaluation.")
    ] = "",
    channel: Annotated[
        str, typer.Option(help="csv, parquet: one row a message of this channel, e.g. ROBOT_STATE.")
    ] = "",
    instruction: Annotated[
        str, typer.Option(metavar="TEXT", help="lerobot: the task in words [default: the task's name].")
    ] = "",
    json_file: JsonOption = None,
) -> None:
    """Write a log in another format; what opens it: docs/EXPORT.md."""
    from tandem.cli.log import find
    from tandem.export.source import open_source
    from tandem.run_folder import shown

    if channel and kind not in (Format.csv, Format.parquet):
        fail(f"--channel is for csv and parquet; {kind.value} holds all channels.", 2)
    with sentences():
        file = find(log)
        out = out or file.with_name(file.stem + SUFFIX[kind])
        source = open_source(file, episodes, phase)
        value = measure(kind, source, out, channel=channel, instruction=instruction)
    counts = ", ".join(f"{n} {name}" for name, n in value["counts"].items())
    print(
        f"{shown(out)}: {counts}; {value['out_bytes'] / 1e6:.1f} MB from {value['log_bytes'] / 1e6:.1f} MB"
        f" in {value['seconds']:.1f} s ({value['log_mb_per_s']:.1f} MB/s)"
    )
    write_json(json_file, value)


def measure(kind: Format, source: Any, out: Path, channel: str = "", instruction: str = "") -> dict[str, Any]:
    """Exports, and says what came out and how fast."""
    from tandem.log.files import files_of

    begun, begun_cpu = time.perf_counter(), time.process_time()
    try:
        counts = _write(kind, source, out, channel, instruction)
    except OSError as error:
        fail(f"{error.filename or out} can't be written ({error.strerror}).")
    seconds = time.perf_counter() - begun
    log_bytes = sum(file.stat().st_size for file in files_of(source.log))
    files = [file for file in out.rglob("*") if file.is_file()] if out.is_dir() else [out]
    return {
        "format": kind.value,
        "log": str(source.log),
        "out": str(out),
        "counts": counts,
        "log_bytes": log_bytes,
        "out_bytes": sum(file.stat().st_size for file in files),
        "seconds": seconds,
        "cpu_s": time.process_time() - begun_cpu,
        "log_mb_per_s": 1e-6 * log_bytes / seconds,
    }


def _write(kind: Format, source: Any, out: Path, channel: str, instruction: str) -> dict[str, int]:
    if kind is Format.lerobot:
        from tandem.export import lerobot

        return lerobot.write(source, out, instruction)
    if kind is Format.mcap:
        from tandem.export import mcap

        return mcap.write(source, out)
    if kind is Format.rerun:
        try:
            from tandem.export import rerun
        except ModuleNotFoundError as error:
            fail(
                f"{error.name} is not installed; ./tandem export rerun installs it (requirements-rerun.txt)."
            )
        return rerun.write(source, out)
    from tandem.export import table

    return table.write(source, out, kind.value, channel)
