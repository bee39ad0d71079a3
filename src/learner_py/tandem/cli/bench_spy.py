"""`tandem bench spy`: what looking on costs."""

import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, fail, sentences, write_json

PAGES = ("channels", "fields", "robot")


def spy(
    channels: Annotated[int, typer.Option(help="Channels that are published.", min=1, max=100)] = 10,
    hz: Annotated[int, typer.Option(help="Messages a second on each.", min=1, max=5000)] = 1000,
    seconds: Annotated[float, typer.Option(help="Seconds for each page of spy.", min=5.0)] = 20.0,
    json_file: JsonOption = None,
) -> None:
    """CPU share of ./tandem spy (user + system, of one core) in a terminal of 80 x 24, its pages in turns, while
    another program publishes 10 channels at 1 kHz over LCM on this machine; messages lost, by their numbers; time from
    publishing to receipt; beside it the share of a program that does nothing but receive by the lcm package.
    To reach: 25 % of a core, none lost. JSON: channels, hz, pages [{page, cpu_share, sent, received, lost, gaps,
    undecodable, latency_ms {p50, p99, max}}], cpu_share (the largest), reader_cpu_share, ratio, lost, reached.
    """
    from tandem import processes, run_folder
    from tandem.spy import bench

    load = bench.Load(channels, hz, seconds)
    found: list[dict[str, Any]] = []
    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        try:
            reader = bench.measure_reader(Path(name), processes.free_lcm_url(), load)
            print(
                f"reading   {100 * reader:5.1f} % of a core by a Python program that only receives",
                flush=True,
            )
            for page in PAGES:
                found.append(bench.measure(Path(name), processes.free_lcm_url(), load, page, (80, 24)))
                print(_line(found[-1]), flush=True)
        except bench.SpyBenchError as error:
            fail(str(error))
    share, lost = max(page["cpu_share"] for page in found), sum(page["lost"] for page in found)
    value = {
        "channels": channels,
        "hz": hz,
        "pages": found,
        "cpu_share": share,
        "reader_cpu_share": reader,
        "ratio": share / reader if reader else None,
        "lost": lost,
        "targets": {"cpu_share": bench.TARGET_CPU_SHARE, "lost": 0},
        "reached": {"cpu_share": share <= bench.TARGET_CPU_SHARE, "lost": lost == 0},
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    measured = {
        "cpu_share": f"{100 * share:.1f} % of a core at {channels} channels x {hz} Hz"
        f" (target: {100 * bench.TARGET_CPU_SHARE:.0f} %)",
        "lost": f"{lost} messages lost of {sum(page['sent'] for page in found)} (target: 0)",
    }
    reached = value["reached"]
    assert isinstance(reached, dict)
    for key, sentence in measured.items():
        print(f"{'reached' if reached[key] else 'MISSED '}  {sentence}")
    host = run_folder.host()
    print(f"on {host['cpu']}, {host['cores']} cores, load {value['load_average']:.1f}, {host['system']}")
    write_json(json_file, value)


def _line(page: dict[str, Any]) -> str:
    latency = page["latency_ms"]
    age = (
        f"receipt after p50 {latency['p50']:.2f}, p99 {latency['p99']:.2f} ms"
        if latency
        else "receipt not timed"
    )
    return (
        f"{page['page']:<9} {100 * page['cpu_share']:5.1f} % of a core; {page['received']} of {page['sent']} messages,"
        f" {page['lost']} lost, {page['gaps']} missing by their numbers; {age}"
    )
