"""`tandem bench log`: how fast logs are read, decoded and indexed, beside LCM's own readers."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json


def log(
    source: Annotated[
        Path | None,
        typer.Option("--log", help="Log to repeat [default: 20 demonstrations, recorded now]."),
    ] = None,
    mb: Annotated[float, typer.Option(help="MB of the log that is read.", min=1, max=100_000)] = 1000.0,
    rounds: Annotated[int, typer.Option(help="Rounds of all readers; the medians count.", min=1)] = 3,
    folder: Annotated[
        Path | None, typer.Option(help="Where the log is written for the while [default: /tmp].")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Read, decode and index a large log: ours, the Python lcm reader and lcm-logfilter, in turns.

    MB a second of wall time, and of CPU time, which a busy machine changes less. JSON: rows of reader, mb, mb_per_s,
    mb_per_cpu_s, wall_s, cpu_s; log_mb, events, index_mb.
    """
    from tandem import log_bench
    from tandem.cli.log.common import find

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-", dir=folder) as name:
        real = find(source) if source else log_bench.record(Path(name))
        large = Path(name) / "large.lcm"
        try:
            copies = log_bench.repeat(real, large, mb)
        except OSError as error:
            fail(f"{large} can't be written ({error.strerror}); give a roomier place by --folder.")
        print(f"{large.stat().st_size / 1e6:.0f} MB: {real} {copies} times", flush=True)
        turns = log_bench.in_turns(
            large,
            rounds,
            lambda reader, turn: print(
                f"  {reader:<42} {turn.mb_per_s:7.0f} MB/s, {turn.wall_s:.2f} s", flush=True
            ),
        )
        value = log_bench.report(turns, large, copies)
    print(f"medians of {rounds}:")
    print(f"  {'':<42} {'MB/s':>8} {'MB/CPU s':>9} {'s':>7} {'CPU s':>7}")
    for row in value["rows"]:
        print(
            f"  {row['reader']:<42} {row['mb_per_s']:>8.0f} {row['mb_per_cpu_s']:>9.0f} {row['wall_s']:>7.2f}"
            f" {row['cpu_s']:>7.2f}"
        )
    print(
        f"{value['events']} events; the index takes {value['index_mb']:.1f} MB; {value['host']['cpu']},"
        f" {value['host']['cores']} cores, load {value['load_average']:.1f}"
    )
    write_json(json_file, value)
