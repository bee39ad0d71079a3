"""What a run's critic can tell apart, asked on episodes that it has not seen.

The learner is run again on the run's log without every fifth training episode; on those, the critic must rank chunks
whose merit is known: the human's against the one that he took over from, the executed one against itself disturbed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tandem import log
from tandem.images import Pixels
from tandem.learner.config import LearnerScenario
from tandem.learner.episode import Episode
from tandem.learner.networks import HEADS, cameras, read_config
from tandem.learner.trainer import Trainer
from tandem.learner.windows import Windows
from tandem.policy_file import network, read_header, read_safetensors
from tandem.run_folder import RunFolder

HELD_OUT_EVERY = 5  # training episodes
DISTURBANCES = (0.1, 0.3, 1.0)  # standard deviations, action units
QUICKER = 1.25  # times the same motion
ON_ITS_WAY = 0.5  # action units, of a step's translation
# Steps of an intervention in which the human's chunk counts as better than that of the policy that he stopped.
AFTER_TAKEOVER = 3

Floats = NDArray[Any]


@dataclass(frozen=True)
class Question:
    """Held-out windows and the policy that drove, or would have driven, when they were recorded."""

    episode: Episode
    windows: Windows
    policy: Path | None  # the last checkpoint that had not learnt from the episode


def diagnose(folder: RunFolder, scenario: LearnerScenario, updates: int) -> dict[str, Any]:
    """Figures of a finished run; `updates` gradient updates on the rest of its episodes come first.

    Raises ValueError with a sentence when the run has no critic or too few episodes.
    """
    trainer = Trainer(scenario)
    if not trainer.method.has_critic:
        raise ValueError(
            f"{folder.path}: method {scenario.method.name} has no critic; there is nothing to ask it."
        )
    training = 0
    held_out: list[Question] = []
    for episode in log.episodes(folder.log):
        if not episode.is_learnable:
            continue
        training += episode.is_training
        if episode.is_training and training % HELD_OUT_EVERY == 0:
            policy = _policy_before(folder, episode)
            held_out.append(Question(episode, trainer.method.windows(episode), policy))
        else:
            trainer.ingest(episode)
    if len(held_out) < 2 or trainer.normalizer is None:
        raise ValueError(
            f"{folder.path} has {training} training episodes; {2 * HELD_OUT_EVERY} are needed to hold some out."
        )
    trainer.relearn(updates)
    return {
        "method": scenario.method.name,
        "held_out_episodes": len(held_out),
        "held_out_steps": sum(q.episode.n_steps for q in held_out),
        "updates": updates,
        **_returns(trainer, held_out),
        **_takeovers(trainer, held_out),
        "disturbed_wins": _disturbed(trainer, held_out),
        "quicker_gain": quicker_gain(trainer, held_out),
        "operator": _operator(folder),
    }


def _returns(trainer: Trainer, held_out: list[Question]) -> dict[str, float]:
    """How well Q predicts what was earned, and what it promises for the actor's own chunks."""
    q = np.concatenate([_scores(trainer, one.windows, one.windows.chunk) for one in held_out])
    earned = np.concatenate([one.windows.mc_return for one in held_out])
    q_own = np.concatenate([_scores(trainer, one.windows, _own(trainer, one.windows)) for one in held_out])
    members = [
        trainer.member_scores(one.windows.observation, one.windows.chunk, one.windows.image)
        for one in held_out
    ]
    error = earned - q
    return {
        "r_squared": float(1.0 - np.mean(error**2) / max(np.var(earned), 1e-12)),
        "spread_of_ensemble": float(np.concatenate(members, axis=1).std(axis=0).mean()),
        "policy_wins": float(np.mean(q_own >= q)),
        "policy_gain": float(np.mean(q_own - q)),  # what the critic promises for following the policy
        "overestimation": float(np.mean(q - earned)),
    }


def _takeovers(trainer: Trainer, held_out: list[Question]) -> dict[str, Any]:
    """Pairs in the same state: the human's chunk just after a takeover, and that of the policy that he stopped."""
    wins: list[float] = []
    gaps: list[float] = []
    for one in held_out:
        rows = _after_takeover(one.episode)
        if one.policy is None or not rows.any():
            continue
        image = None if one.windows.image is None else one.windows.image[rows]
        stopped = _chunks(one.policy, one.episode.observation[rows], image)
        human = _scores(trainer, one.windows, one.windows.chunk)[rows]
        policy = trainer.score(one.episode.observation[rows], stopped, image)
        wins += list(human > policy)
        gaps += list(human - policy)
    return {
        "human_pairs": len(wins),
        "human_wins": float(np.mean(wins)) if wins else None,
        "human_gain": float(np.mean(gaps)) if gaps else None,
    }


def _disturbed(trainer: Trainer, held_out: list[Question]) -> dict[str, float]:
    """Share of executed chunks that score below themselves plus noise: half means that the critic can't tell."""
    generator = np.random.default_rng(0)
    shares = {}
    for deviation in DISTURBANCES:
        wins = []
        for one in held_out:
            chunk = one.windows.chunk
            noise = deviation * generator.standard_normal(chunk.shape)
            disturbed = np.clip(chunk + noise, -1.0, 1.0).astype(np.float32)
            wins.append(_scores(trainer, one.windows, disturbed) > _scores(trainer, one.windows, chunk))
        shares[str(deviation)] = float(np.mean(np.concatenate(wins)))
    return shares


def quicker_gain(trainer: Trainer, held_out: list[Question]) -> float | None:
    """What the critic promises for going the same way quicker, where the arm is on its way by itself.

    Less time is worth more; a critic that says otherwise has mistaken something else for the cause.
    """
    axes = trainer.scenario.task.action_axes
    translation = [axes.index(axis) for axis in ("x", "y", "z") if axis in axes]
    motion = [axes.index(axis) for axis in axes if axis != "gripper"]
    gains: list[float] = []
    for one in held_out:
        chunk = one.windows.chunk
        speed = np.linalg.norm(chunk[:, 0, translation], axis=1)
        rows = (speed > ON_ITS_WAY) & ~one.windows.human[:, 0]
        quicker = chunk.copy()
        quicker[:, :, motion] = np.clip(QUICKER * quicker[:, :, motion], -1.0, 1.0)
        gains += list((_scores(trainer, one.windows, quicker) - _scores(trainer, one.windows, chunk))[rows])
    return float(np.mean(gains)) if gains else None


def _operator(folder: RunFolder) -> dict[str, float | None]:
    """Who is rescued, and how often; None where there was no such episode."""
    training = [e for e in log.episodes(folder.log) if e.is_training and e.is_learnable]
    helped = [bool(e.intervention.any()) for e in training]
    succeeded = [e.outcome == "success" for e in training]
    alone = [s for s, h in zip(succeeded, helped, strict=True) if not h]
    rescued = [s for s, h in zip(succeeded, helped, strict=True) if h]
    return {
        "episodes": len(training),
        "helped": float(np.mean(helped)),
        "success_alone": float(np.mean(alone)) if alone else None,
        "success_helped": float(np.mean(rescued)) if rescued else None,
        "human_steps": float(np.mean(np.concatenate([e.intervention for e in training]))),
    }


def _after_takeover(episode: Episode) -> Floats:
    """(T,) the first steps of each intervention."""
    rows = np.zeros(episode.n_steps, bool)
    begins = np.flatnonzero(episode.intervention & ~np.append(False, episode.intervention[:-1]))
    for begin in begins:
        rows[begin : begin + AFTER_TAKEOVER] = episode.intervention[begin : begin + AFTER_TAKEOVER]
    return rows


def _policy_before(folder: RunFolder, episode: Episode) -> Path | None:
    before = [f for steps, f in folder.checkpoints().items() if steps < episode.end.env_steps_total]
    return before[-1] if before else None


def _chunks(policy: Path, observation: Floats, image: Pixels | None) -> Floats:
    """What a policy file would have done (B, h, A), for one draw of its noise."""
    header, (tensors, _) = read_header(policy), read_safetensors(policy)
    config = read_config(header.architecture, header.config)
    head = HEADS[header.architecture]
    x = (observation - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    n = head.noise_size(config, len(header.action))
    noise = np.random.default_rng(0).standard_normal((len(x), n)).astype(np.float32)
    images = {} if image is None else {camera.name: image for camera in cameras(config)}
    return np.asarray(head.chunk(network(tensors, header.architecture), config, x, noise, images))


def _scores(trainer: Trainer, windows: Windows, chunk: Floats) -> Floats:
    return trainer.score(windows.observation, chunk, windows.image)


def _own(trainer: Trainer, windows: Windows) -> Floats:
    return trainer.sample(windows.observation, windows.image)
