"""`tandem bench loop`: how punctual the control loop is, beside cyclictest in the same run."""

import os
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from tandem.cli.common import JsonOption, SetOption, fail, sentences, write_json
from tandem.histogram import Histogram


def loop(
    task: Annotated[str, typer.Option(help="Task that the arm is at.")] = "peg",
    seconds: Annotated[
        float, typer.Option(help="Seconds of the control loop; cyclictest gets as many.", min=2.0)
    ] = 60.0,
    slices: Annotated[int, typer.Option(help="Turns that the two take.", min=1, max=1000)] = 6,
    core: Annotated[
        int, typer.Option(help="Core of loop and cyclictest [default: the last that we may use].")
    ] = -1,
    overrides: SetOption = None,
    json_file: JsonOption = None,
    png: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture of the histograms [default: beside the JSON file]."),
    ] = None,
) -> None:
    """The 1 kHz loop in real time while a learner trains on the other cores: computing time of a tick and lateness
    of waking up (us), the latter beside cyclictest's with the same priority on the same core, in turns.

    The controller runs a policy on the simulated arm, with its recorder and policy threads on the same core.
    To reach: tick compute p99 <= 50 us; wake-up p99.9 <= 1.5 x cyclictest's; no allocation. A target that is missed
    is said, and does not fail the command. JSON: ticks, overruns, allocations, tick_compute_us, wakeup_us,
    cyclictest_us {p50, p99, p999, max}, wakeup_p999_ratio, targets, reached, slices.
    """
    from tandem import loop_bench, processes, run_folder, scenario

    with sentences(), tempfile.TemporaryDirectory(prefix="tandem-bench-") as name:
        folder = Path(name)
        try:
            loop_bench.cyclictest()
            core, others = loop_bench.cores(core)
            if sentence := processes.missing_program([run_folder.program("tandem_controller")]):
                fail(sentence)
            setting = scenario.compose(run_folder.CONFIG, task, "tandem", {}, overrides or [])
            print("Demonstrations and a first policy ...", flush=True)
            prepared = loop_bench.prepare(folder, setting, others)
            found: list[loop_bench.Slice] = []
            at = loop_bench.priority(setting)
            with loop_bench.training(folder, setting, prepared, others) as updates:
                began, before = time.monotonic(), updates()
                for i in range(slices):
                    turn = folder / f"slice-{i}"
                    ours = loop_bench.controller_slice(turn, setting, prepared.policy, seconds / slices, core)
                    theirs = loop_bench.cyclictest_slice(turn, seconds / slices, core, at)
                    found.append(loop_bench.Slice(ours, theirs))
                    print(f"slice {i + 1} of {slices}: {_line(loop_bench.report(found[-1:]))}", flush=True)
                rate = (updates() - before) / (time.monotonic() - began)
        except loop_bench.LoopBenchError as error:
            fail(str(error))
    value = {
        **loop_bench.report(found),
        "core": core,
        "priority": at,
        "learner_cores": others,
        "learner_updates_per_s": rate,
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }
    _print(value)
    write_json(json_file, value)
    if png is None and json_file is not None and str(json_file) != "-":
        png = json_file.with_suffix(".png")
    if png is not None:
        draw(png, loop_bench.histograms(found), value)


def _line(value: dict[str, Any]) -> str:
    return (
        f"{value['ticks']} ticks, tick p99 {value['tick_compute_us']['p99']:.1f} us,"
        f" wake-up p99.9 {value['wakeup_us']['p999']:.1f} us,"
        f" cyclictest p99.9 {value['cyclictest_us']['p999']:.1f} us, {value['overruns']} overruns"
    )


def _print(value: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("us", "p50", "p99", "p99.9", "max")
    rows = {"computing a tick": "tick_compute_us", "waking up": "wakeup_us", "cyclictest": "cyclictest_us"}
    for name, key in rows.items():
        table.add_row(name, *(f"{value[key][p]:.1f}" for p in ("p50", "p99", "p999", "max")))
    Console().print(table)
    allocations = "not counted" if value["allocations"] is None else value["allocations"]
    print(
        f"{value['ticks']} ticks, {value['overruns']} overruns, allocations: {allocations};"
        f" the learner did {value['learner_updates_per_s']:.0f} updates/s meanwhile."
    )
    measured = {
        "tick_compute_p99_us": f"p99 of a tick is {value['tick_compute_us']['p99']:.1f} us (target: 50 us)",
        "wakeup_p999_ratio": f"p99.9 of waking up is {value['wakeup_p999_ratio']:.2f} x cyclictest's (target: 1.5)",
        "allocations": f"allocations: {allocations} (target: 0)",
    }
    for name, sentence in measured.items():
        print(f"{'reached' if value['reached'][name] else 'MISSED '}  {sentence}")
    if value["load_average"] > len(value["learner_cores"]) + 1.5:
        print(f"The machine is busy (load {value['load_average']:.1f}); measure it idle.")


def draw(path: Path, found: dict[str, Histogram], value: dict[str, Any]) -> None:
    """Computing time and both lateness distributions, counts on a log scale."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True, layout="constrained")
    panels = {
        "tick_compute_us": (left, "computing a tick", "C0"),
        "wakeup_us": (right, "control thread", "C0"),
        "cyclictest_us": (right, "cyclictest", "C1"),
    }
    for name, (axes, label, color) in panels.items():
        x, y = _per_microsecond(found[name])
        axes.step(x, y, where="post", color=color, label=label)
        p999 = value[name]["p999"]
        axes.axvline(
            p999, color=color, linestyle=":", label=f"p99.9 = {p999:.1f} us, max {value[name]['max']:.0f} us"
        )
    left.axvline(50, color="grey", linestyle="--", label="target for p99")
    left.set(
        title=f"{value['ticks']} ticks, {value['overruns']} overruns", xlabel="us", ylabel="ticks per us"
    )
    right.set(title="lateness of waking up, in turns on one core", xlabel="us")
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xscale("log")
        axes.legend(loc="upper right", fontsize="small")
        axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _per_microsecond(histogram: Histogram) -> tuple[list[float], list[int]]:
    """Counts by whole microsecond, so that histograms with different buckets compare; all beyond at the maximum."""
    counts: dict[int, int] = {}
    for bucket, n in histogram.counts.items():
        us = int(bucket * histogram.bucket_us)
        counts[us] = counts.get(us, 0) + n
    if histogram.beyond:
        counts[int(histogram.max_us)] = counts.get(int(histogram.max_us), 0) + histogram.beyond
    x = sorted(counts)
    return [max(float(us), 0.5) for us in x], [counts[us] for us in x]
