"""summary.json of a run: what came out, under names that other tools rely on, and the table for people."""

import csv
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from tandem_lcm.tandem.world_state_t import world_state_t

from tandem.log import messages
from tandem.run_folder import RunFolder, git_revision, host
from tandem.scenario import Scenario
from tandem.statistics import mean, percent, share

PROGRESS_COLUMNS = (
    "wall_s",
    "env_steps",
    "episode",
    "updates",
    "buffer_steps",
    "critic_loss",
    "actor_loss",
    "win_share",
    "win_share_human",
    "win_share_autonomous",
    "updates_per_s",
)


def read_episodes(log: Path) -> list[Any]:
    """EPISODE_END of every complete episode in a log, by number."""
    if not log.exists():
        return []
    found = {}
    for event in messages(log, "EPISODE_END"):
        found[event.message.episode] = event.message
    return [found[number] for number in sorted(found)]


def training_episodes(episodes: list[Any]) -> list[Any]:
    return [end for end in episodes if end.phase == world_state_t.TRAINING]


def read_progress(path: Path) -> list[dict[str, float]]:
    """Rows of progress.csv; a line cut off by a kill is left out."""
    if not path.exists():
        return []
    rows = []
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            try:
                rows.append({key: float(row[key]) for key in PROGRESS_COLUMNS})
            except (TypeError, ValueError):
                continue
    return rows


def interventions(episodes: list[Any]) -> dict[str, Any]:
    """Human share of the training steps, over all, the first and the last tenth of them, and take-overs."""

    def human(part: list[Any]) -> float:
        return share(sum(e.n_intervention_steps for e in part), sum(e.n_steps for e in part))

    total = sum(e.n_steps for e in episodes)
    begun, first, last = 0, [], []
    for end in episodes:
        if begun < 0.1 * total:
            first.append(end)
        begun += end.n_steps
        if begun > 0.9 * total:
            last.append(end)
    return {
        "share": human(episodes),
        "takeovers": sum(e.n_takeovers for e in episodes),
        "share_first_tenth": human(first),
        "share_last_tenth": human(last),
    }


class Fresh(NamedTuple):
    """Results on fresh seeds."""

    selected: dict[str, Any]
    last: dict[str, Any]
    operator: dict[str, Any]


def build(
    folder: RunFolder,
    scenario: Scenario,
    curve: list[dict[str, Any]],
    results: Fresh,
    clock: dict[str, Any],
    controller: dict[str, Any],
) -> dict[str, Any]:
    """Joins the evaluations' results, the log and the clock.

    curve: results of the checkpoints, ascending; clock: clock.json; controller: results of the controller's
    last process, {} when there is none.
    """
    selected, last, operator = results
    episodes = training_episodes(read_episodes(folder.log))
    env_steps = max((e.env_steps_total for e in episodes), default=0)
    updates = max((e["updates"] for e in curve), default=0)
    seconds = clock["seconds"]
    learning_s = seconds.get("warm start", 0.0) + seconds.get("training", 0.0)
    reports = clock["updates_per_s"]
    peaks = [e.force_peak for e in episodes]
    rate = scenario.data["task"].get("policy_rate_hz", 10)

    def fresh(value: dict[str, Any]) -> dict[str, Any]:
        keys = (
            "env_steps",
            "updates",
            "success",
            "successes",
            "episodes",
            "wilson",
            "steps_mean",
            "force",
            "seed",
        )
        return {key: value[key] for key in keys}

    return {
        "task": scenario.run["task"],
        "method": scenario.run["method"],
        "seed": scenario.run["seed"],
        "env_steps": env_steps,
        "robot_time_s": env_steps / rate,
        "updates": updates,
        "wall_s": sum(
            seconds.get(part, 0.0) for part in ("start", "demonstrations", "warm start", "training")
        ),
        "curve": [
            {
                "env_steps": e["env_steps"],
                "updates": e["updates"],
                "wall_s": clock["checkpoints"].get(str(e["env_steps"])),
                "success": e["success"],
                "episodes": e["episodes"],
                "successes": e["successes"],
                "steps_mean": e["steps_mean"],
            }
            for e in curve
        ],
        "fresh": {"selected": fresh(selected), "last": fresh(last)},
        "operator": {
            k: operator[k] for k in ("success", "steps_mean", "successes", "episodes", "wilson", "force")
        },
        "policy": {"steps_mean": selected["steps_mean"], "force": selected["force"]},
        "interventions": interventions(episodes),
        "throughput": {
            "env_steps_per_s": share(env_steps, seconds.get("training", 0.0)),
            "updates_per_s": share(reports["sum"], reports["n"]) or share(updates, learning_s),
        },
        "force": {"peak_mean": mean(peaks), "peak_max": max(peaks, default=None)},
        "training_episodes": len(episodes),
        "demonstrations": scenario.run["demonstrations"],
        "clock": scenario.run["clock"],
        "overruns": clock.get("overruns", 0),
        "tick_compute_us": controller.get("tick_compute_us"),
        "wakeup_us": controller.get("wakeup_us"),
        "wall": {
            "start_s": seconds.get("start", 0.0),
            "demonstrations_s": seconds.get("demonstrations", 0.0),
            "warm_start_s": seconds.get("warm start", 0.0),
            "training_s": seconds.get("training", 0.0),
            "final_evaluation_s": seconds.get("final evaluation", 0.0),
        },
        "resumed": clock.get("resumed", 0),
        "git_revision": git_revision(),
        "host": host(),
    }


def rows(value: dict[str, Any]) -> list[tuple[str, str]]:
    """The summary for people: label and text."""
    shown: list[tuple[str, str]] = []

    def row(label: str, text: str) -> None:
        shown.append((label, text))

    def steps(number: float | None) -> str:
        return "-" if number is None else f"{number:.1f}"

    row(
        "training",
        f"{value['env_steps']} env steps = {value['robot_time_s']:.0f} s of robot time,"
        f" {value['updates']} updates",
    )
    wall = value["wall"]
    row(
        "wall time",
        f"{value['wall_s']:.0f} s: demonstrations {wall['demonstrations_s']:.0f},"
        f" warm start {wall['warm_start_s']:.0f},"
        f" training {wall['training_s']:.0f}; then evaluation {wall['final_evaluation_s']:.0f}",
    )
    for which in ("selected", "last"):
        fresh = value["fresh"][which]
        text = percent(fresh["successes"], fresh["episodes"])
        row(f"success, {which}", f"{text} on fresh seeds, checkpoint at {fresh['env_steps']} env steps")
    operator = value["operator"]
    row("success, operator", percent(operator["successes"], operator["episodes"]))
    row(
        "steps to success",
        f"policy {steps(value['policy']['steps_mean'])}, operator {steps(operator['steps_mean'])}",
    )
    human = value["interventions"]
    row(
        "human share",
        f"{100 * human['share']:.1f} % of training steps"
        f" ({100 * human['share_first_tenth']:.1f} % in the first tenth,"
        f" {100 * human['share_last_tenth']:.1f} % in the last), {human['takeovers']} take-overs",
    )
    force = value["policy"]["force"]
    row(
        "peak force",
        f"policy {steps(force['peak_mean'])} N mean, {steps(force['peak_max'])} N max per episode",
    )
    speed = value["throughput"]
    row("speed", f"{speed['env_steps_per_s']:.0f} env steps/s, {speed['updates_per_s']:.0f} updates/s")
    if value["clock"] == "realtime":
        row("overruns", str(value["overruns"]))
    return shown


def table(value: dict[str, Any]) -> Table:
    """The same for a terminal."""
    shown = Table(
        title=f"{value['task']} · {value['method']} · seed {value['seed']}",
        show_header=False,
        title_justify="left",
    )
    shown.add_column(style="bold")
    shown.add_column()
    for label, text in rows(value):
        shown.add_row(label, text)
    return shown
