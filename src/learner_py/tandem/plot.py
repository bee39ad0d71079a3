"""The learning curve of a run as a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tandem.statistics import share, wilson

WINDOW = 20  # episodes in a moving share
ENV_STEPS = "env steps (0.1 s of robot time each)"


def curve(
    path: Path,
    title: str,
    evaluations: list[dict[str, Any]],
    episodes: Sequence[Any],
    progress: list[dict[str, float]],
    operator_success: float | None = None,
) -> None:
    """Draws success with its 95 % Wilson band, human share and the policy's win share against env steps.

    evaluations: results with env_steps, successes, episodes; episodes: EPISODE_END of training, in order;
    progress: rows of progress.csv.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(
        2, 1, sharex=True, figsize=(7, 6), height_ratios=(3, 2), layout="constrained"
    )
    draw_success(top, evaluations, operator_success)
    top.set(title=title)
    draw_shares(bottom, episodes, progress)
    bottom.set(xlabel=ENV_STEPS)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def draw_success(axes: Any, evaluations: list[dict[str, Any]], operator_success: float | None) -> None:
    """Success of the policy alone with its 95 % Wilson band, and of the operator alone."""
    steps = [e["env_steps"] for e in evaluations]
    bands = [wilson(e["successes"], e["episodes"]) for e in evaluations]
    axes.fill_between(
        steps, [b[0] for b in bands], [b[1] for b in bands], alpha=0.2, label="95 % Wilson interval"
    )
    axes.plot(
        steps, [share(e["successes"], e["episodes"]) for e in evaluations], marker="o", label="policy alone"
    )
    if operator_success is not None:
        axes.axhline(operator_success, color="grey", linestyle="--", linewidth=1, label="operator alone")
    axes.set(ylabel="success", ylim=(-0.02, 1.02))
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)


def draw_shares(axes: Any, episodes: Sequence[Any], progress: list[dict[str, float]]) -> None:
    """The human's share of the steps and the policy's of the comparisons."""
    x, y = human_share(episodes)
    axes.plot(x, y, label=f"human steps, share of the last {WINDOW} episodes")
    wins = [(row["env_steps"], row["win_share"]) for row in progress if row["win_share"] == row["win_share"]]
    if wins:
        axes.plot(
            [w[0] for w in wins],
            [w[1] for w in wins],
            alpha=0.8,
            label="samples where the policy's action wins",
        )
    axes.set(ylabel="share", ylim=(-0.02, 1.02))
    axes.legend(loc="upper right")
    axes.grid(alpha=0.3)


def human_share(episodes: Sequence[Any]) -> tuple[list[int], list[float]]:
    """(env steps, share of human steps over the last WINDOW training episodes)."""
    x, y = [], []
    for i, end in enumerate(episodes):
        recent = episodes[max(0, i + 1 - WINDOW) : i + 1]
        x.append(end.env_steps_total)
        y.append(share(sum(e.n_intervention_steps for e in recent), sum(e.n_steps for e in recent)))
    return x, y
