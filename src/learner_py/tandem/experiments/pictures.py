"""The pictures of an experiment's report: curves, win shares, and what the last policies are like."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tandem.experiments import figures
from tandem.experiments.figures import Result
from tandem.statistics import mean

Points = Sequence[tuple[float, float]]  # (x, y), ascending in x


def band(series: Sequence[Points], n: int = 200) -> tuple[list[float], list[float], list[float], list[float]]:
    """x, mean, lowest and highest of several curves whose x differ; straight lines between their points.

    From where all have begun to where the last one ends; one that ends earlier keeps its last value, because its policy
    stays what it is.
    """
    import numpy as np

    columns = [tuple(np.asarray(points, float).T) for points in series]
    start, end = max(x[0] for x, _ in columns), max(x[-1] for x, _ in columns)
    own = {value for x, _ in columns for value in x if start <= value <= end}
    grid = np.array(sorted(own)) if len(own) <= n else np.linspace(start, end, n)
    values = np.stack([np.interp(grid, x, y) for x, y in columns])
    return (
        grid.tolist(),
        values.mean(axis=0).tolist(),
        values.min(axis=0).tolist(),
        values.max(axis=0).tolist(),
    )


def success_points(result: Result, clock: str) -> Points:
    """Success of a run's checkpoints against env_steps, robot_time_s or wall_s."""
    summary = result.summary
    step_s = summary["robot_time_s"] / summary["env_steps"] if summary["env_steps"] else math.nan
    points = []
    for point in summary.get("curve", []):
        x = point["env_steps"] * step_s if clock == "robot_time_s" else point[clock]
        if x is not None and math.isfinite(x):
            points.append((float(x), float(point["success"])))
    return sorted(points)


def win_points(result: Result, column: str) -> Points:
    """A win share against env steps; reports of the same step are averaged, empty ones left out.

    Before the first training step there is none: the warm start imitates without comparing.
    """
    at: dict[float, list[float]] = {}
    for row in result.progress:
        if row["env_steps"] > 0 and math.isfinite(row[column]):
            at.setdefault(row["env_steps"], []).append(row[column])
    return [(steps, sum(values) / len(values)) for steps, values in sorted(at.items())]


def draw_curves(path: Path, title: str, results: Mapping[str, list[Result]]) -> None:
    panels = [
        ("env_steps", "env steps", 1.0),
        ("robot_time_s", "robot time, min", 60.0),
        ("wall_s", "wall time of training, min", 60.0),
    ]
    series = [
        (name, {label: [success_points(r, clock) for r in runs] for label, runs in results.items()}, unit)
        for clock, name, unit in panels
    ]
    _draw(path, title, "success of the policy alone", series)


def draw_win_shares(path: Path, title: str, results: Mapping[str, list[Result]]) -> bool:
    """False, and no picture, when no method compares chunks."""
    panels = [
        ("win_share_human", "env steps; logged chunks that a human drove"),
        ("win_share_autonomous", "env steps; logged chunks that the policy drove"),
    ]
    comparing = {
        label: runs
        for label, runs in results.items()
        if any(win_points(run, column) for run in runs for column, _ in panels)
    }
    if not comparing:
        return False
    series = [
        (name, {label: [win_points(r, column) for r in runs] for label, runs in comparing.items()}, 1.0)
        for column, name in panels
    ]
    _draw(path, title, "share of wins of the policy's chunk", series)
    return True


def draw_last(
    path: Path, title: str, rows: Sequence[dict[str, Any]], results: Mapping[str, list[Result]]
) -> None:
    """What the last policies are like, a line a label: success, human's share, steps and peak force.

    rows: of the report's table, one a label. Dots are what it says, strokes the label's runs; dashed is the operator,
    mean of all labels.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    single = [[figures.row(label, [run]) for run in runs] for label, runs in results.items()]
    figure, axes = plt.subplots(
        1, 4, sharey=True, figsize=(13, 1.2 + 0.32 * len(rows)), layout="constrained", squeeze=False
    )
    success, share, steps, force = axes[0]
    for y, (row, runs) in enumerate(zip(rows, single, strict=True)):
        last = row["last"]
        low, high = (100 * bound for bound in last["wilson"])
        success.plot([low, high], [y, y], color="C0", linewidth=2, alpha=0.5)
        _dots(success, y, 100 * last["success"], [100 * run["last"]["success"] for run in runs])
        if None not in (first_last := (row["human_share_first_tenth"], row["human_share_last_tenth"])):
            first, end = (100 * value for value in first_last)
            share.plot([first, end], [y, y], color="C0", linewidth=1, alpha=0.5)
            share.plot(first, y, "o", color="C0", fillstyle="none")
            share.plot(end, y, "o", color="C0")
        _dots(steps, y, row["steps_mean"], [run["steps_mean"] for run in runs])
        _dots(force, y, row["force_peak_N"], [run["force_peak_N"] for run in runs])
    for axis, key in ((steps, "operator_steps_mean"), (force, "operator_force_peak_N")):
        operator = mean([row[key] for row in rows if row[key] is not None])
        if operator is not None:
            axis.axvline(operator, color="0.4", linestyle="--", linewidth=1)
    names = ("success, %", "human's share, %", "steps to success", "peak force, N")
    for axis, name in zip(axes[0], names, strict=True):
        axis.set(xlabel=name)
        axis.grid(alpha=0.3)
    success.set(xlim=(None, 100.5), ylim=(len(rows) - 0.5, -0.5))
    success.set(yticks=range(len(rows)), yticklabels=list(results))
    figure.suptitle(title)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _dots(axis: Any, y: float, pooled: float | None, runs: Sequence[float | None]) -> None:
    known = [value for value in runs if value is not None]
    axis.plot(known, [y] * len(known), "|", color="C0", markersize=8)
    if pooled is not None:
        axis.plot(pooled, y, "o", color="C0")


def _draw(
    path: Path, title: str, y_name: str, panels: Sequence[tuple[str, Mapping[str, list[Points]], float]]
) -> None:
    """One panel an x axis (name, curves by label, divisor of x), one colour a label."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(panels), sharey=True, squeeze=False, figsize=(5 * len(panels), 4.5), layout="constrained"
    )
    for axis, (x_name, curves, unit) in zip(axes[0], panels, strict=True):
        colours = plt.get_cmap("tab10" if len(curves) <= 10 else "tab20")
        for number, (label, runs) in enumerate(curves.items()):
            if not (series := [points for points in runs if points]):
                continue
            x, mean, low, high = band(series)
            x = [value / unit for value in x]
            colour = colours(number % colours.N)
            axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)
            axis.plot(x, mean, color=colour, marker="." if len(x) < 40 else None, label=label)
        axis.set(xlabel=x_name, ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
    axes[0][0].set(ylabel=y_name)
    if axes[0][0].get_legend_handles_labels()[0]:
        axes[0][0].legend(fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=120)
    plt.close(figure)
