"""One episode on a page: where the tool was, what it felt, who drove, what it was worth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tandem.learner.episode import Episode, EpisodeAssembler
from tandem.log.event_log import EventLog
from tandem.log.events import Array
from tandem.log.values import Values, policy_of, values
from tandem.soak.torques import TORQUE_LIMIT

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class EpisodeData:
    """What the log tells of one episode; columns by channel, empty where it tells nothing."""

    episode: Episode
    state: dict[str, Array]  # ROBOT_STATE
    world: dict[str, Array]  # WORLD_STATE
    chunk: dict[str, Array]  # ACTION_CHUNK
    step_s: float
    values: Values | None


class NoEpisodeError(Exception):
    """A sentence: which episode is not there, or not whole."""


def read_episode(log: EventLog, number: int) -> EpisodeData:
    """Raises NoEpisodeError with a sentence."""
    found = np.flatnonzero(log.episodes.number == number)
    if not len(found):
        there = log.episodes.number
        have = f"it has {there.min()} to {there.max()}" if len(there) else "it has no whole episode"
        raise NoEpisodeError(f"{log.path} holds no episode {number}; {have}.")
    first, last = int(log.episodes.first[found[0]]), int(log.episodes.last[found[0]])

    def columns(channel: str, *names: str) -> dict[str, Array]:
        rows = log.index.rows(channel, readable=True)
        return log.columns(channel, *names, rows=rows[(rows >= first) & (rows <= last)])

    episode = _whole(log, first, last)
    chunk = columns("ACTION_CHUNK", "taken_tick", "start_tick", "chunk_id", "policy_version", "policy_chunk")
    ticks_per_step = round(1000 / float(log.scenario.get("task", {}).get("policy_rate_hz", 10)))
    policy = policy_of(log, episode) if episode.n_steps else None
    of_policy = None
    if policy is not None and chunk["policy_chunk"].ndim == 3:
        of_policy = values(policy, episode, chunk["start_tick"] // ticks_per_step, chunk["policy_chunk"])
    elif policy is not None:
        of_policy = values(policy, episode, np.empty(0, np.int64), np.empty((0, 1, 7)))
    return EpisodeData(
        episode,
        columns(
            "ROBOT_STATE",
            *(
                "tick",
                "p_WE_measured",
                "p_WE_reference",
                "F_ext_W",
                "force_bound_W",
                "tau_commanded",
                "alpha",
            ),
        ),
        columns("WORLD_STATE", "tick", "p_WO", "p_WG"),
        chunk,
        ticks_per_step / 1000,
        of_policy,
    )


def _whole(log: EventLog, first: int, last: int) -> Episode:
    assembler = EpisodeAssembler()
    rows = log.index.rows("EPISODE_STEP", "EPISODE_END", readable=True)
    end: Any = None
    for event in log.events(rows[(rows >= first) & (rows <= last)]):
        if event.channel == "EPISODE_STEP":
            assembler.add_step(event.message, event.data)
        else:
            end = event.message
            assembler.add_end(end)
    episode = assembler.take(end.episode)
    if episode is None:
        raise NoEpisodeError(
            f"{log.path}: episode {end.episode} is not whole; ./tandem log check tells more."
        )
    return episode


def draw(data: EpisodeData, path: Path, title: str) -> None:
    """Writes the page as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = [_position, _force, _torque, _actions, _authority]
    if data.values is not None:
        panels.append(_q)
    figure, axes = plt.subplots(
        len(panels), 1, sharex=True, figsize=(11, 2.1 * len(panels) + 0.8), layout="constrained"
    )
    for axis, panel in zip(axes, panels, strict=True):
        panel(axis, data)
        _shade(axis, data)
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
    axes[-1].set_xlabel("s of the episode; shaded: the human is engaged; ticks on top: chunks take over")
    end = data.episode.end
    figure.suptitle(
        f"{title} · episode {end.episode}, {data.episode.phase}: {data.episode.outcome} after {end.n_steps} steps,"
        f" policy {end.policy_version}, {end.n_intervention_steps} human steps, peak force {end.force_peak:.0f} N",
        fontsize="medium",
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)


def interventions(episode: Episode) -> list[tuple[int, int]]:
    """[begin, end) in steps, of each stretch with the human engaged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], episode.intervention.astype(int), [0]])))
    return [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]


def _shade(axis: Any, data: EpisodeData) -> None:
    for begin, end in interventions(data.episode):
        axis.axvspan(begin * data.step_s, end * data.step_s, color="tab:orange", alpha=0.15, linewidth=0)
    for tick in data.chunk["taken_tick"].tolist():
        axis.axvline(tick / 1000, ymin=0.97, color="0.4", linewidth=0.8)


def _steps(data: EpisodeData) -> Array:
    return np.arange(data.episode.n_steps) * data.step_s


def _position(axis: Any, data: EpisodeData) -> None:
    world = data.world
    if len(world["row"]):
        to_goal = 1e3 * (world["p_WO"] - world["p_WG"])
        for i, name in enumerate(AXES):
            axis.plot(world["tick"] / 1000, to_goal[:, i], color=f"C{i}", label=f"object less goal {name}")
    if len(data.state["row"]):
        lead = 1e3 * (data.state["p_WE_reference"] - data.state["p_WE_measured"])
        seconds = data.state["tick"] / 1000
        for i, name in enumerate(AXES):
            axis.plot(
                seconds, lead[:, i], color=f"C{i}", linestyle=":", label=f"reference less measured {name}"
            )
    axis.set(ylabel="mm, base axes")
    axis.set_yscale("symlog", linthresh=5.0)


def _force(axis: Any, data: EpisodeData) -> None:
    state = data.state
    seconds = state["tick"] / 1000
    for i, name in enumerate(AXES):
        axis.plot(
            seconds, state["F_ext_W"][:, i] if len(seconds) else [], color=f"C{i}", label=f"force {name}"
        )
    if len(seconds):
        bound = state["force_bound_W"][:, 2]
        axis.fill_between(seconds, -bound, bound, color="0.5", alpha=0.12, label="static bound z")
    axis.set(ylabel="N, on the tool")


def _torque(axis: Any, data: EpisodeData) -> None:
    state = data.state
    for joint in range(7 if len(state["row"]) else 0):
        share = 100 * state["tau_commanded"][:, joint] / TORQUE_LIMIT[joint]
        axis.plot(state["tick"] / 1000, share, linewidth=0.8, label=f"joint {joint + 1}")
    axis.set(ylabel="torque, % of limit")


def _actions(axis: Any, data: EpisodeData) -> None:
    episode, seconds = data.episode, _steps(data)
    for i, name in enumerate(AXES):
        axis.step(
            seconds, episode.executed_action[:, i], where="post", color=f"C{i}", label=f"executed {name}"
        )
        axis.plot(
            seconds, episode.policy_action[:, i], ".", markersize=3, color=f"C{i}", label=f"policy {name}"
        )
        human = np.where(episode.intervention, episode.human_action[:, i], np.nan)
        axis.plot(seconds, human, "x", markersize=4, color=f"C{i}", label=f"human {name}")
    axis.set(ylabel="action", ylim=(-1.1, 1.1))


def _authority(axis: Any, data: EpisodeData) -> None:
    if len(data.state["row"]):
        axis.plot(data.state["tick"] / 1000, data.state["alpha"], label="authority of the human")
    else:
        axis.step(_steps(data), data.episode.alpha, where="post", label="authority of the human")
    axis.plot(_steps(data), data.episode.discounted_return, label="return")
    axis.set(ylabel="share", ylim=(-0.05, 1.05))


def _q(axis: Any, data: EpisodeData) -> None:
    assert data.values is not None
    seconds = _steps(data)
    axis.plot(seconds, data.values.executed, label="Q of what was executed")
    axis.plot(seconds, data.values.asked, label="Q of the policy's chunk")
    axis.set(ylabel=f"Q, critic {data.values.version}")
