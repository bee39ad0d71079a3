"""One run on a page: success, the human's share, losses, forces, and how the loop kept its time.

The log tells the episodes; losses, evaluations and the loop's histogram come from the run folder where they are there.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tandem.histogram import Histogram
from tandem.log.event_log import EventLog
from tandem.log.events import Array
from tandem.plot import WINDOW
from tandem.run_folder import RunFolder
from tandem.summary import read_progress

_END = (
    *("episode", "phase", "outcome", "n_steps", "n_intervention_steps", "env_steps_total", "force_peak"),
    *("force_filtered_peak",),
)
_TRAINING = 1
_SUCCESS = 0


def draw(log: EventLog, path: Path, title: str) -> list[str]:
    """Writes the page as a picture; returns which panels it has."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    ends = log.columns("EPISODE_END", *_END, rows=log.episodes.last)
    folder = RunFolder(log.path.parent)
    progress = read_progress(folder.progress)
    histograms = loop_histograms(folder.path / "controller.json")
    panels: dict[str, Any] = {
        "success": lambda axis: _success(axis, ends, _evaluations(folder)),
        "human share": lambda axis: _human(axis, ends),
        "force": lambda axis: _force(axis, ends),
    }
    if progress:
        panels["losses"] = lambda axis: _losses(axis, progress)
    if histograms:
        panels["loop"] = lambda axis: _loop(axis, histograms)
    figure, axes = plt.subplots(len(panels), 1, figsize=(8, 2.4 * len(panels) + 0.6), layout="constrained")
    for axis, panel in zip(axes, panels.values(), strict=True):
        panel(axis)
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return list(panels)


def loop_histograms(results: Path) -> dict[str, Histogram]:
    """Of the controller's last process, by what was measured; {} when it left none."""
    try:
        value = json.loads(results.read_text())
        found = {
            "computing a tick": Histogram.of_controller(value["tick_compute_histogram_us"]),
            "waking up late": Histogram.of_controller(value["wakeup_histogram_us"]),
        }
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {name: histogram for name, histogram in found.items() if histogram.total}


def _evaluations(folder: RunFolder) -> list[dict[str, Any]]:
    found = []
    for file in sorted(folder.evaluations.glob("*.json")):
        try:
            value = json.loads(file.read_text())
            found.append({"env_steps": value["env_steps"], "success": value["success"]})
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return sorted(found, key=lambda value: value["env_steps"])


def recent(part: Array, whole: Array) -> Array:
    """Share of `part` in `whole` over the last WINDOW rows, at every row."""
    sums = [np.cumsum(np.append(0, values)) for values in (part, whole)]
    begin = np.maximum(0, np.arange(len(part)) + 1 - WINDOW)
    parts, wholes = (of[1:] - of[begin] for of in sums)
    return np.where(wholes > 0, parts / np.maximum(wholes, 1), 0.0)


def _training(ends: dict[str, Array]) -> dict[str, Array]:
    return {name: column[ends["phase"] == _TRAINING] for name, column in ends.items()}


def _success(axis: Any, ends: dict[str, Array], evaluations: list[dict[str, Any]]) -> None:
    training = _training(ends)
    good = training["outcome"] == _SUCCESS
    alone = training["n_intervention_steps"] == 0
    ones = np.ones(len(good))
    axis.plot(
        training["env_steps_total"], recent(good, ones), label=f"training, last {WINDOW} episodes, with help"
    )
    axis.plot(training["env_steps_total"], recent(good & alone, ones), label="of them without any help")
    if evaluations:
        axis.plot(
            [value["env_steps"] for value in evaluations],
            [value["success"] for value in evaluations],
            marker="o",
            label="policy alone, evaluated",
        )
    axis.set(ylabel="success", xlabel="env steps", ylim=(-0.03, 1.03))


def _human(axis: Any, ends: dict[str, Array]) -> None:
    training = _training(ends)
    axis.plot(
        training["env_steps_total"],
        recent(training["n_intervention_steps"], training["n_steps"]),
        label=f"human steps, share of the last {WINDOW} episodes",
    )
    axis.set(ylabel="share", xlabel="env steps", ylim=(-0.03, 1.03))


def _force(axis: Any, ends: dict[str, Array]) -> None:
    axis.plot(ends["episode"], ends["force_peak"], ".", label="peak force")
    axis.plot(ends["episode"], ends["force_filtered_peak"], ".", label="the same, filtered")
    axis.set(ylabel="N", xlabel="episode", ylim=(0, None))


def _losses(axis: Any, progress: list[dict[str, float]]) -> None:
    updates = [row["updates"] for row in progress]
    for name in ("critic_loss", "actor_loss"):
        axis.plot(updates, [row[name] for row in progress], label=name.replace("_", " "))
    axis.set(ylabel="loss", xlabel="updates", yscale="log")


def _loop(axis: Any, histograms: dict[str, Histogram]) -> None:
    for name, histogram in histograms.items():
        buckets = np.array(sorted(histogram.counts))
        counts = [histogram.counts[bucket] for bucket in buckets.tolist()]
        p99 = histogram.percentiles()["p99"]
        axis.step(
            (buckets + 1) * histogram.bucket_us, counts, where="post", label=f"{name}: p99 {p99:.0f} us"
        )
    axis.set(ylabel="ticks", xlabel="us", yscale="log", xscale="log")
