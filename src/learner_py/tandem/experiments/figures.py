"""What finished runs show: their summaries, joined to one row a label."""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

from tandem.experiments.runs import Run
from tandem.run_folder import RunFolderError, shown
from tandem.statistics import mean, percent, wilson
from tandem.summary import read_progress

SUSTAINED_SUCCESS = 0.95
SUSTAINED_CHECKPOINTS = 3

FROM_START = (
    "hil_serl",
)  # methods whose time the paper counts from the start, not from the first checkpoint


class Result(NamedTuple):
    """A finished run: summary.json and the rows of progress.csv."""

    run: Run
    summary: dict[str, Any]
    progress: list[dict[str, float]]


def collect(runs: Sequence[Run]) -> dict[str, list[Result]]:
    """The finished runs by label, in the order of `runs`; labels without any are left out."""
    found: dict[str, list[Result]] = {}
    for run in runs:
        if not run.finished:
            continue
        try:
            summary = json.loads(run.folder.summary.read_text())
        except (OSError, ValueError) as error:
            raise RunFolderError(f"{shown(run.folder.summary)} can't be read ({error}).") from None
        found.setdefault(run.label, []).append(Result(run, summary, read_progress(run.folder.progress)))
    return found


def sustained(curve: Sequence[dict[str, Any]]) -> int | None:
    """Env steps of the first checkpoint from which success stays >= 95 % for 3 checkpoints (or to the end).

    curve: checkpoints of a run, ascending. None when that never happens. A single lucky checkpoint does not count,
    unless it is the last.
    """
    for first, point in enumerate(curve):
        stretch = curve[first : first + SUSTAINED_CHECKPOINTS]
        if all(p["success"] >= SUSTAINED_SUCCESS for p in stretch):
            return int(point["env_steps"])
    return None


def row(label: str, results: Sequence[Result]) -> dict[str, Any]:
    """One label's figures: success pooled over its seeds, everything else the mean of its runs.

    Steps and forces are the last checkpoint's, as curves are not cut at their peak.

    `sustained_env_steps` stays by seed: a mean over those who got there would flatter who seldom does.
    """
    summaries = [result.summary for result in results]

    def average(*path: str) -> float | None:
        values = [_at(summary, path) for summary in summaries]
        return mean([value for value in values if value is not None])

    value: dict[str, Any] = {
        "label": label,
        "method": summaries[0]["method"],
        "seeds": [summary["seed"] for summary in summaries],
    }
    for which in ("selected", "last"):
        fresh = [summary["fresh"][which] for summary in summaries]
        successes, episodes = sum(f["successes"] for f in fresh), sum(f["episodes"] for f in fresh)
        value[which] = {
            "success": successes / episodes,
            "successes": successes,
            "episodes": episodes,
            "wilson": list(wilson(successes, episodes)),
            "by_seed": [f["success"] for f in fresh],
            "env_steps": [f["env_steps"] for f in fresh],
        }
    return value | {
        "sustained_env_steps": [sustained(summary.get("curve", [])) for summary in summaries],
        "env_steps": average("env_steps"),
        "robot_time_s": average("robot_time_s"),
        "updates": average("updates"),
        "wall_s": average("wall_s"),
        "human_share": average("interventions", "share"),
        "human_share_first_tenth": average("interventions", "share_first_tenth"),
        "human_share_last_tenth": average("interventions", "share_last_tenth"),
        "steps_mean": average("fresh", "last", "steps_mean"),
        "operator_steps_mean": average("operator", "steps_mean"),
        "force_peak_N": average("fresh", "last", "force", "peak_mean"),
        "force_filtered_peak_N": average("fresh", "last", "force", "filtered_peak_mean"),
        "operator_force_peak_N": average("operator", "force", "peak_mean"),
    }


def paper_row(label: str, results: Sequence[Result]) -> dict[str, Any]:
    """The same runs by the paper's conventions, by seed.

    success: the best checkpoint's own (50) episodes, which picked it, so it is biased upwards. The rest is of the first
    checkpoint that has it: env steps; training steps = gradient updates; time = wall time of training since the first
    checkpoint, for HIL-SERL since the start. Warm start and demonstrations are in no time.
    """
    best, seconds = [], []
    for result in results:
        curve = result.summary["curve"]
        first = max(curve, key=lambda point: point["success"])  # of equals the first
        best.append(first)
        zero = 0.0 if result.summary["method"] in FROM_START else curve[0]["wall_s"]
        seconds.append(None if None in (first["wall_s"], zero) else first["wall_s"] - zero)
    return {
        "label": label,
        "success": [point["success"] for point in best],
        "episodes": [point["episodes"] for point in best],
        "env_steps": [point["env_steps"] for point in best],
        "training_steps": [point["updates"] for point in best],
        "time_s": seconds,
    }


def _at(value: Any, path: Sequence[str]) -> Any:
    """A value inside of a summary, None where an older one lacks it."""
    for key in path:
        value = value.get(key) if isinstance(value, dict) else None
    return value


# ---- as text

HEAD = (
    "seeds",
    "selected",
    "by seed",
    "last",
    "≥ 95 % from step",
    "env steps",
    "robot time",
    "wall time",
    "updates",
    "human (first → last tenth)",
    "steps (operator)",
    "peak force (filtered)",
)
ABOUT_SUCCESS = 5  # columns of HEAD; the others are about what it took
PAPER_HEAD = ("highest success", "by seed", "env steps", "training steps", "time")


def cells(value: dict[str, Any]) -> list[str]:
    """A row as text, label first, then as HEAD."""
    return [
        value["label"],
        str(len(value["seeds"])),
        percent(value["selected"]["successes"], value["selected"]["episodes"]),
        ", ".join(f"{100 * success:.1f}" for success in value["selected"]["by_seed"]),
        percent(value["last"]["successes"], value["last"]["episodes"]),
        ", ".join("-" if steps is None else str(steps) for steps in value["sustained_env_steps"]),
        f"{value['env_steps']:.0f}",
        f"{value['robot_time_s'] / 60:.1f} min",
        f"{value['wall_s'] / 60:.1f} min",
        f"{value['updates']:.0f}",
        f"{100 * value['human_share']:.1f} % ({_percent(value['human_share_first_tenth'])}"
        f" → {_percent(value['human_share_last_tenth'])})",
        f"{_one(value['steps_mean'])} ({_one(value['operator_steps_mean'])})",
        f"{_one(value['force_peak_N'])} N ({_one(value['force_filtered_peak_N'])})",
    ]


def paper_cells(value: dict[str, Any]) -> list[str]:
    seconds = [s for s in value["time_s"] if s is not None]
    average = mean(seconds)
    return [
        value["label"],
        f"{100 * (mean(value['success']) or 0.0):.1f} %",
        ", ".join(f"{100 * success:.0f}" for success in value["success"]),
        f"{mean(value['env_steps']) or 0.0:.0f}",
        f"{mean(value['training_steps']) or 0.0:.0f}",
        "-" if average is None else f"{average / 3600:.3f} h",
    ]


def _one(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f}"
