"""The charts of RUN/report.html, as SVG whose words stay words."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from tandem import plot
from tandem.histogram import Histogram
from tandem.run_facts import Facts
from tandem.words import OUTCOMES

POINTS = 1000  # of a curve; longer ones are thinned out
_COLOURS = {"success": "C2", "timeout": "C1", "failure": "C3", "fault": "k", "discard": "0.7"}


def charts(facts: Facts) -> list[tuple[str, str, str]]:
    """Heading, what it shows, SVG. Those without data are left out."""
    operator = (facts.summary or {}).get("operator", {})
    drawn: list[tuple[str, str, str]] = []

    def add(heading: str, about: str, draw: Callable[[Any], None], there: Any) -> None:
        if there:
            drawn.append((heading, about, _svg(draw, f"chart{len(drawn)}")))

    add(
        "Success",
        f"The policy alone on {facts.scenario.run['evaluation_episodes']} fixed seeds that training never uses, at each"
        " checkpoint.",
        lambda axes: plot.draw_success(axes, facts.evaluations, operator.get("success")),
        facts.evaluations,
    )
    add(
        "Human share and wins",
        "How much of the training the human did, and how often the critic prefers the policy's own action.",
        lambda axes: plot.draw_shares(axes, facts.episodes, thinned(facts.progress)),
        facts.episodes,
    )
    add(
        "Episode length",
        f"Policy steps of each training episode by its outcome, and the mean of the last {plot.WINDOW}.",
        lambda axes: _lengths(axes, facts.episodes, operator.get("steps_mean")),
        facts.episodes,
    )
    add(
        "Force",
        "Largest external force on the tool in each training episode: raw, and as the operator feels it.",
        lambda axes: _forces(axes, facts.episodes),
        facts.episodes,
    )
    add(
        "Losses", "Mean of each block of updates.", lambda axes: _losses(axes, facts.progress), facts.progress
    )
    histograms = _histograms(facts)
    add(
        "Control loop",
        f"1 ms ticks on the wall clock; {facts.controller.get('overruns', 0)} overruns"
        f" in {facts.controller.get('ticks', 0)} ticks of the last start.",
        lambda axes: _loop(axes, histograms),
        histograms,
    )
    return drawn


def thinned(values: Sequence[Any]) -> list[Any]:
    """At most POINTS of them, evenly, the last one included."""
    if len(values) <= POINTS:
        return list(values)
    return [values[round(i * (len(values) - 1) / (POINTS - 1))] for i in range(POINTS)]


def _lengths(axes: Any, episodes: list[Any], operator: float | None) -> None:
    for name, colour in _COLOURS.items():
        some = thinned([end for end in episodes if OUTCOMES.get(end.outcome) == name])
        if some:
            axes.plot(
                [e.env_steps_total for e in some], [e.n_steps for e in some], ".", color=colour, label=name
            )
    _moving(axes, episodes, "n_steps", "C0")
    if operator is not None:
        axes.axhline(operator, color="grey", linestyle="--", linewidth=1, label="operator alone")
    axes.set(ylabel="policy steps", ylim=(0, None))
    axes.legend(loc="upper right", fontsize="small")
    axes.grid(alpha=0.3)


def _forces(axes: Any, episodes: list[Any]) -> None:
    for name, label, colour in (("force_peak", "raw", "C3"), ("force_filtered_peak", "filtered", "C0")):
        some = thinned(episodes)
        x = [end.env_steps_total for end in some]
        axes.plot(x, [getattr(end, name) for end in some], ".", markersize=4, alpha=0.5, color=colour)
        _moving(axes, episodes, name, colour, f"{label}, mean of {plot.WINDOW}")
    axes.set(ylabel="N", ylim=(0, None))
    axes.legend(loc="upper right", fontsize="small")
    axes.grid(alpha=0.3)


def _moving(axes: Any, episodes: list[Any], name: str, colour: str, label: str = "") -> None:
    """The mean over the last WINDOW episodes."""
    values = [float(getattr(end, name)) for end in episodes]
    means = []
    for i in range(len(values)):
        recent = values[max(0, i + 1 - plot.WINDOW) : i + 1]
        means.append((episodes[i].env_steps_total, sum(recent) / len(recent)))
    points = thinned(means)
    axes.plot(
        [p[0] for p in points], [p[1] for p in points], color=colour, label=label or f"mean of {plot.WINDOW}"
    )


def _losses(axes: Any, progress: list[dict[str, float]]) -> None:
    for name, label in (("critic_loss", "critic"), ("actor_loss", "actor")):
        rows = [row for row in progress if math.isfinite(row[name]) and row[name] > 0]
        some = thinned(rows)
        if some:
            axes.plot([row["updates"] for row in some], [row[name] for row in some], label=label)
    axes.set(ylabel="loss", xlabel="updates", yscale="log")
    if axes.lines:
        axes.legend(loc="upper right", fontsize="small")
    axes.grid(alpha=0.3)


def _histograms(facts: Facts) -> dict[str, Histogram]:
    """Of a real-time run."""
    if facts.scenario.run["clock"] != "realtime":
        return {}
    names = {"computing a tick": "tick_compute_histogram_us", "waking up late": "wakeup_histogram_us"}
    found = {}
    for label, key in names.items():
        if (value := facts.controller.get(key)) and value.get("counts"):
            found[label] = Histogram.of_controller(value)
    return found


def _loop(axes: Any, histograms: dict[str, Histogram]) -> None:
    for label, histogram in histograms.items():
        buckets = sorted(histogram.counts)
        told = ", ".join(f"{name} {value:.0f}" for name, value in histogram.percentiles().items())
        axes.step(
            [max(bucket, 0.5) * histogram.bucket_us for bucket in buckets],
            [histogram.counts[bucket] for bucket in buckets],
            where="post",
            label=f"{label}: {told} us",
        )
    axes.axvline(1000, color="grey", linestyle="--", linewidth=1, label="period")
    axes.set(xlabel="us", ylabel="ticks", xscale="log", yscale="log")
    axes.legend(loc="upper right", fontsize="small")
    axes.grid(alpha=0.3)


def _svg(draw: Callable[[Any], None], name: str) -> str:
    """One chart as an <svg> element whose words stay words and whose ids are its own."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "font.size": 10}):
        figure, axes = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
        axes.set(xlabel=plot.ENV_STEPS)
        draw(axes)
        out = io.StringIO()
        figure.savefig(
            out, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
        plt.close(figure)
    svg = out.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    # matplotlib numbers the parts of every file alike; in one page they must differ
    return re.sub(r'(\bid="|href="#|url\(#)([^")]+)', rf"\1{name}-\2", svg)
