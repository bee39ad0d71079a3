"""Windows: what a learner may know about step t of an episode, correct by construction.

    chunk[t]    executed actions t .. t+h-1, active axes only, human, robot or mixed
    valid[t]    which of them exist; the tail is padded by "hold" (zero delta, same gripper) or by the last action over
                again. A critic sees the padding; imitation masks it, because nobody chose it.
    G[t]        sum over k < T-t of gamma^k reward[t+k], less what hard contacts cost, by a discount of their own; a
                time-out earns 0 and nothing is bootstrapped
    rest[t]     with images: how far the tool still went from step t on, until the hand was told otherwise or the
                episode ended; NaN where the episode did not succeed, for then nobody knows
    R[t], b[t]  for critics that bootstrap after n steps: sum over k < min(n, T-t) of gamma^k r[t+k], r the reward less
                what the step's hardest contact costs, and what the value of next_observation counts: gamma^min(n, T-t),
                0 where the episode truly ended. A time-out is no end.

A window never reaches into another episode, because it is cut out of one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tandem.images import Pixels, decode_all
from tandem.learner.episode import ACTION_AXES, Bools, Episode, Floats

GRIPPER = ACTION_AXES.index("gripper")
# float32 on the wire against double here; a wrong discount or a shifted reward is off by far more
RETURN_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Windows:
    """One row a step of the episode; T steps, O observations, A active axes, horizon h."""

    observation: Floats  # (T, O) raw
    chunk: Floats  # (T, h, A) in [-1, 1]
    valid: Bools  # (T, h)
    human: Bools  # (T, h) valid and chosen by a human: engaged, or a demonstration
    mc_return: Floats  # (T,) G, with the cut when it is asked for
    next_observation: Floats  # (T, O) raw, after the last valid of the n steps
    n_step_return: Floats  # (T,) R
    bootstrap: Floats  # (T,) b
    image: Pixels | None = None  # (T, H, W, 3) RGB; None without a camera
    rest: Floats | None = None  # (T, 6) m and rad; None without a camera
    next_image: Pixels | None = None  # (T, H, W, 3) of next_observation; None when nothing bootstraps

    def columns(self) -> dict[str, np.ndarray]:
        """What there is of them, by name."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}


def make_windows(
    episode: Episode,
    columns: Sequence[int],
    horizon: int,
    discount: float,
    cut_return_at_intervention: bool = False,
    force_free_N: float = 0.0,
    force_cost_per_N: float = 0.0,
    force_discount: float | None = None,
    repeat_at_the_end: bool = False,
    bootstrap_steps: int = 1,
    timeout_is_terminal: bool = False,
    image_size: tuple[int, int] | None = None,
    next_images: bool = False,
    lead: Floats | None = None,
    action_limit: Floats | None = None,
) -> Windows:
    """Cuts a learnable episode into windows. `columns`: the active axes among the 7 numbers of an action.

    cut_return_at_intervention: autonomous steps that a human takeover follows later in the episode earn nothing (the
    rescue counts as failure of what came before); human steps, and autonomous ones after the last takeover, keep G.
    force_cost_per_N: what each newton costs by which a step's largest contact force exceeds force_free_N;
    force_discount: per step of that cost in G, None: the discount of the reward.
    repeat_at_the_end: the tail is padded by the last action, which does not tell that success is near.
    image_size: height and width of the images, None when they are not looked at; next_images: those of
    next_observation too. lead, action_limit: for rest_of_the_way; None when nobody asks for it.
    bootstrap_steps: n. timeout_is_terminal: b is 0 after a time-out too, as in HIL-SERL.
    """
    if not episode.is_learnable:
        raise ValueError(
            f"Episode {episode.number} ({episode.phase}) ended by {episode.outcome}; it must not reach the learner."
        )
    length = episode.n_steps
    chunk, valid = executed_chunks(episode, columns, horizon, repeat_at_the_end)
    last = np.minimum(np.arange(length)[:, None] + np.arange(horizon)[None, :], length - 1)  # (T, h) steps

    by_human = np.ones(length, bool) if episode.is_demonstration else episode.intervention
    earned = discounted_returns(episode.reward, discount)
    _check_returns(episode, earned, discount)
    cost = force_cost_per_N * np.maximum(0.0, episode.force_peak - force_free_N)
    paid = discounted_returns(cost, discount)
    blamed = discounted_returns(cost, discount if force_discount is None else force_discount)
    credited = earned
    if cut_return_at_intervention:
        credited = np.where(~by_human & followed_by_intervention(by_human), 0.0, earned)

    ends = np.minimum(np.arange(length) + bootstrap_steps, length)  # (T,) the step after the last of the n
    over = episode.terminated[ends - 1] | (episode.truncated[ends - 1] & timeout_is_terminal)
    decay = discount ** (ends - np.arange(length))
    net = np.append(earned - paid, 0.0)
    pixels = None if image_size is None else _pixels(episode, image_size)
    return Windows(
        observation=episode.observation,
        chunk=chunk,
        valid=valid,
        human=valid & by_human[last],
        mc_return=(credited - blamed).astype(np.float32),
        next_observation=episode.next_observation[ends - 1],
        n_step_return=(net[:-1] - decay * net[ends]).astype(np.float32),
        bootstrap=np.where(over, 0.0, decay).astype(np.float32),
        image=None if pixels is None else pixels[:-1],
        rest=None if lead is None or action_limit is None else rest_of_the_way(episode, lead, action_limit),
        next_image=None if pixels is None or not next_images else pixels[ends],
    )


def _pixels(episode: Episode, size: tuple[int, int]) -> Pixels:
    """(T + 1, H, W, 3)"""
    if not episode.images:
        raise ValueError(
            f"Episode {episode.number} has no images; it was recorded without run.observe image, and this run has it."
        )
    pixels = decode_all(episode.images)
    if pixels.shape[1:3] != size:
        raise ValueError(
            f"Episode {episode.number} has images of {pixels.shape[2]} x {pixels.shape[1]} px;"
            f" controller.camera of the scenario says {size[1]} x {size[0]}."
        )
    return pixels


def executed_chunks(
    episode: Episode, columns: Sequence[int], horizon: int, repeat_at_the_end: bool = False
) -> tuple[Floats, Bools]:
    """(T, h, A) what was executed from each step on, and (T, h) which of it was; the tail is padded by "hold", or by
    the last action over again."""
    index = np.arange(episode.n_steps)[:, None] + np.arange(horizon)[None, :]
    valid = index < episode.n_steps
    executed = episode.executed_action[np.minimum(index, episode.n_steps - 1)]  # (T, h, 7)
    if repeat_at_the_end:
        return executed[:, :, list(columns)].astype(np.float32), valid
    hold = np.zeros(7, np.float32)
    hold[GRIPPER] = episode.executed_action[-1, GRIPPER]
    chunk = np.where(valid[:, :, None], executed, hold)[:, :, list(columns)]
    return chunk.astype(np.float32), valid


def discounted_returns(reward: Floats, discount: float) -> np.ndarray:
    """G (T,) in double: G[t] = r[t] + gamma G[t+1], nothing after the end."""
    returns = np.zeros(len(reward), np.float64)
    running = 0.0
    for step in range(len(reward) - 1, -1, -1):
        running = float(reward[step]) + discount * running
        returns[step] = running
    return returns


def rest_of_the_way(episode: Episode, lead: Floats, action_limit: Floats) -> Floats:
    """(T, 6), m and rad: see `rest` above.

    The tool goes where its commanded pose goes, less what that leads by. lead (T + 1, 6): commanded minus measured pose
    at each observation, the last of the end. action_limit (6,): what an action of 1 moves the commanded pose by.
    """
    rest = np.full((episode.n_steps, GRIPPER), np.nan, np.float32)
    if episode.outcome != "success":
        return rest
    # of the tool, in each step
    moved = episode.executed_action[:, :GRIPPER] * action_limit - np.diff(lead, axis=0)
    closed = episode.executed_action[:, GRIPPER] > 0.0
    ahead = np.zeros(GRIPPER, np.float32)
    for step in range(episode.n_steps - 1, -1, -1):
        if step + 1 < episode.n_steps and closed[step + 1] != closed[step]:
            ahead = np.zeros(GRIPPER, np.float32)
        ahead = ahead + moved[step]
        rest[step] = ahead
    return rest


def with_discount(episode: Episode, discount: float) -> Episode:
    """The same episode for a run with another discount than the one that it was recorded in."""
    returns = discounted_returns(episode.reward, discount).astype(np.float32)
    return replace(episode, discounted_return=returns)


def followed_by_intervention(by_human: Bools) -> Bools:
    """(T,) True where a later step of the same episode is a human's."""
    later = np.zeros(len(by_human), bool)
    later[:-1] = np.maximum.accumulate(by_human[::-1])[::-1][1:]
    return later


def _check_returns(episode: Episode, returns: np.ndarray, discount: float) -> None:
    """The controller computed the same numbers; a difference means that it runs another scenario."""
    error = np.abs(returns - episode.discounted_return)
    step = int(np.argmax(error))
    if not error[step] <= RETURN_TOLERANCE:
        raise ValueError(
            f"Episode {episode.number}, step {step}: discounted_return is {episode.discounted_return[step]:.6g} "
            f"on the wire but {returns[step]:.6g} recomputed with discount {discount}; "
            f"they may differ by {RETURN_TOLERANCE}. Controller and learner must run the same scenario."
        )
