"""`bench loop`: histograms are added and read right, targets are judged, and a missed one does not fail."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tandem import loop_bench
from tandem.cli import bench_loop
from tandem.histogram import Histogram, added
from tandem.loop_bench import LoopBenchError, Slice
from tandem.run_folder import ROOT


def of(us: dict[int, int], bucket_us: float = 0.2, max_us: float = 0.0) -> dict[str, Any]:
    """As the controller writes it: n durations that fall into the bucket of so many us."""
    counts = [0] * 10_001
    for duration, n in us.items():
        counts[min(10_000, int(duration / bucket_us))] += n
    return {"bucket_us": bucket_us, "counts": counts, "max_us": max_us or float(max(us))}


def a_slice(tick: dict[int, int], wakeup: dict[int, int], cyclictest: dict[int, int], **more: Any) -> Slice:
    controller = {
        "ticks": sum(tick.values()),
        "overruns": 0,
        "allocations": 0,
        "tick_compute_histogram_us": of(tick),
        "wakeup_histogram_us": of(wakeup),
        **more,
    }
    counts = {str(us): n for us, n in cyclictest.items()}
    thread = {"histogram": counts, "cycles": sum(cyclictest.values()), "max": max(cyclictest)}
    return Slice(controller, {"thread": {"0": thread}})


def test_percentiles_are_those_of_all_slices_together_not_a_mean_of_each() -> None:
    quiet, loud = a_slice({10: 990}, {5: 990}, {5: 990}), a_slice({400: 10}, {5: 10}, {5: 10})
    value = loop_bench.report([quiet, loud])
    assert value["tick_compute_us"]["p99"] == pytest.approx(10.2)
    assert value["tick_compute_us"]["p999"] == 400.0
    assert value["ticks"] == 1000
    assert [row["tick_compute_us"]["max"] for row in value["slices"]] == [10.0, 400.0]


def test_what_lies_beyond_the_buckets_counts_as_the_maximum() -> None:
    histogram = added([Histogram.of_controller(of({1: 900, 5000: 100}, max_us=7000.0))])
    assert histogram.percentiles()["p99"] == 7000.0
    assert histogram.total == 1000
    lost = {"histogram": {"3": 90}, "cycles": 100, "max": 99.0}
    assert Histogram.of_cyclictest({"thread": {"0": lost}}).percentiles()["p99"] == 99.0


def test_histograms_of_other_buckets_are_not_added() -> None:
    with pytest.raises(ValueError, match="can't be added"):
        added([Histogram(0.2), Histogram(1.0)])


def test_targets_are_judged_by_ratio_and_allocations() -> None:
    good = loop_bench.report([a_slice({20: 1000}, {7: 1000}, {6: 1000})])
    assert good["reached"] == {"tick_compute_p99_us": True, "wakeup_p999_ratio": True, "allocations": True}
    bad = loop_bench.report([a_slice({60: 1000}, {20: 1000}, {6: 1000}, allocations=3)])
    assert bad["reached"] == {"tick_compute_p99_us": False, "wakeup_p999_ratio": False, "allocations": False}
    uncounted = loop_bench.report([a_slice({20: 1000}, {7: 1000}, {6: 1000}, allocations=None)])
    assert uncounted["allocations"] is None
    assert not uncounted["reached"]["allocations"]


def test_a_controller_without_histograms_is_said_to_be_old() -> None:
    old = a_slice({1: 1}, {1: 1}, {1: 1})
    del old.controller["wakeup_histogram_us"]
    with pytest.raises(LoopBenchError, match="build it again"):
        loop_bench.report([old])


def test_picture_and_figures_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slices = [a_slice({12: 5000, 3000: 1}, {6: 5000, 90: 3}, {5: 5000})]
    value = {**loop_bench.report(slices), "learner_updates_per_s": 100.0, "load_average": 2.0}
    value["learner_cores"] = [0]
    bench_loop.draw(tmp_path / "loop.png", loop_bench.histograms(slices), value)
    assert (tmp_path / "loop.png").stat().st_size > 10_000
    bench_loop._print(value)
    assert "reached" in capsys.readouterr().out
    json.dumps(value)


def test_a_core_that_is_not_ours_is_refused() -> None:
    with pytest.raises(LoopBenchError, match="may use"):
        loop_bench.cores(4096)


def test_the_preloaded_counter_counts_the_allocations_of_its_thread() -> None:
    # The plain one, whatever else is sanitized: this Python is not instrumented.
    counter = ROOT / "build" / "bin" / "libtandem_allocations.so"
    assert counter.exists()
    code = """
import ctypes, threading
count = ctypes.CDLL(None).tandem_allocations
count.restype = ctypes.c_long
before = count()
kept = [bytes(1000) for _ in range(100)]  # above the size that Python's own pools hold
mine = count() - before
there = []
other = threading.Thread(target=lambda: there.append(count()))
other.start()
other.join()
print(mine, there[0] < before)
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "LD_PRELOAD": str(counter)},
        capture_output=True,
        text=True,
        check=True,
    )
    mine, apart = done.stdout.split()
    assert 100 <= int(mine) < 400
    assert apart == "True"
