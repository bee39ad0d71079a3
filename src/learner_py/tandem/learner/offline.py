"""Training from an event log alone: the buffer that a run had, its updates, and the policies that came of them.

The same episodes in the same order through the same `Trainer` as in learner/process.py; only nothing is waited for.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tandem.learner.config import LearnerScenario, load_scenario
from tandem.learner.episode import Episode
from tandem.learner.trainer import Report, Trainer
from tandem.learner.windows import with_discount
from tandem.log import episodes
from tandem.policy_file import read_safetensors
from tandem.run_folder import RunFolder, git_revision

Say = Callable[[str], None]


@dataclass
class Comparison:
    """How this training compares with the run that wrote the log, as far as the run left its own account."""

    buffer_equal: bool | None = (
        None  # None: the run left no digest of its buffer, or it was another scenario's
    )
    policies_equal: dict[int, bool] = field(default_factory=dict)  # by version, every tensor to the bit


@dataclass
class OfflineResult:
    buffer: dict[str, Any]  # Trainer.buffer_digest() at the end
    env_steps: int
    updates: int
    version: int
    missing: list[int]  # episodes that the log does not hold whole
    comparison: Comparison


def train_from(
    log: Path, scenario: LearnerScenario, folder: RunFolder, say: Say, other_discount: bool = False
) -> OfflineResult:
    """Writes the policies of the checkpoints and the last one as `policy.safetensors` into `folder`.

    other_discount: the log was recorded with another one, so its returns are not those of this scenario.
    Raises ValueError with a sentence when there is nothing to learn from or the log contradicts the scenario.
    """
    trainer = Trainer(scenario, git_revision())
    told = sorted(episodes(log), key=lambda episode: episode.number)
    if other_discount:
        told = [with_discount(episode, scenario.method.discount) for episode in told]
    missing = sorted(set(range(max((e.number for e in told), default=-1) + 1)) - {e.number for e in told})
    run = _same_run(log, scenario)
    recorded = json.loads(run.buffer.read_text()) if run and run.buffer.is_file() else {}
    comparison = Comparison(buffer_equal=False if recorded else None)  # until its last episode comes
    if scenario.run.demonstrations == 0:
        trainer.position.version = 1
        _keep(trainer, folder, -1, say)
    for episode in told:
        env_steps_before = trainer.position.env_steps
        trainer.ingest(episode)
        if trainer.position.version == 0 and trainer.is_last_demonstration(episode):
            say(
                f"{trainer.n_demonstrations} demonstrations; warm start of {trainer.updates_due(episode)} updates"
            )
        trainer.train(episode, _go_on)
        if trainer.policy_is_due(episode):
            _keep(trainer, folder, env_steps_before, say)
            if run:
                _compare(trainer, run, folder, comparison)
        if episode.number == recorded.get("episodes_trained_through"):
            comparison.buffer_equal = trainer.buffer_digest() == recorded
    if trainer.normalizer is None or trainer.position.version == 0:
        raise ValueError(_nothing_learnt(log, scenario, told))
    trainer.write_policy(folder.policy)
    return OfflineResult(
        buffer=trainer.buffer_digest(),
        env_steps=trainer.position.env_steps,
        updates=trainer.updates,
        version=trainer.position.version,
        missing=missing,
        comparison=comparison,
    )


def _go_on(_: Report) -> bool:
    return True


def _same_run(log: Path, scenario: LearnerScenario) -> RunFolder | None:
    """The run that wrote the log, when it learnt by the same scenario."""
    run = RunFolder(log.parent)
    if not run.scenario.is_file() or load_scenario(run.scenario).fingerprint() != scenario.fingerprint():
        return None
    return run


def _keep(trainer: Trainer, folder: RunFolder, env_steps_before: int, say: Say) -> None:
    """Writes the policies that a run keeps for evaluation."""
    position, every = trainer.position, trainer.scenario.run.evaluation_every
    if position.version == 1 or position.env_steps // every > env_steps_before // every:
        path = folder.path / "checkpoints" / f"policy_at_{position.env_steps:07d}.safetensors"
        trainer.write_policy(path)
        say(f"{position.env_steps} env steps, {trainer.updates} updates: {path.name}")


def _compare(trainer: Trainer, run: RunFolder, folder: RunFolder, comparison: Comparison) -> None:
    theirs = run.policies().get(trainer.position.version)
    if theirs is not None:
        ours = folder.path / "compared.safetensors"
        trainer.write_policy(ours)
        comparison.policies_equal[trainer.position.version] = _same_tensors(ours, theirs)
        ours.unlink()


def _same_tensors(a: Path, b: Path) -> bool:
    one, other = read_safetensors(a)[0], read_safetensors(b)[0]
    return one.keys() == other.keys() and all(
        np.asarray(one[name]).tobytes() == np.asarray(other[name]).tobytes() for name in one
    )


def _nothing_learnt(log: Path, scenario: LearnerScenario, told: list[Episode]) -> str:
    held = sum(e.is_demonstration and e.is_learnable for e in told)
    return (
        f"{log} holds {held} successful demonstrations and the scenario asks for {scenario.run.demonstrations} before"
        f" training; give --set run.demonstrations={held}."
        if held < scenario.run.demonstrations
        else f"{log} holds no complete episode that a learner may learn from."
    )
