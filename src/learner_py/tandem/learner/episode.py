"""An episode as arrays, made from its messages: what was seen, asked, executed and earned at every step.

Data flow: EPISODE_STEP and EPISODE_END (wire or event log) -> `EpisodeAssembler` -> `Episode` -> `windows.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.episode_step_t import episode_step_t
from tandem_lcm.tandem.world_state_t import world_state_t

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

# the 7 numbers of an action, in their order on the wire
ACTION_AXES = ("x", "y", "z", "rx", "ry", "rz", "gripper")

OUTCOME_NAMES = {
    episode_end_t.SUCCESS: "success",
    episode_end_t.TIMEOUT: "timeout",
    episode_end_t.FAULT: "fault",
    episode_end_t.DISCARD: "discard",
    episode_end_t.FAILURE: "failure",
}
PHASE_NAMES = {
    world_state_t.DEMONSTRATION: "demonstration",
    world_state_t.TRAINING: "training",
    world_state_t.EVALUATION: "evaluation",
}


@dataclass(frozen=True)
class Episode:
    """T policy steps; row t is step t. Actions are the 7 numbers of the wire, in [-1, 1]."""

    number: int
    end: episode_end_t
    observation: Floats  # (T, O) raw, when the step began
    next_observation: Floats  # (T, O) raw, when the step ended
    policy_action: Floats  # (T, 7) what the policy asked
    human_action: Floats  # (T, 7) what the human asked
    executed_action: Floats  # (T, 7) what the arm was really told
    alpha: Floats  # (T,) human authority, [0, 1]
    intervention: Bools  # (T,) the human was engaged
    terminated: Bools  # (T,)
    truncated: Bools  # (T,)
    reward: Floats  # (T,)
    discounted_return: Floats  # (T,) as the controller computed it
    policy_version: Ints  # (T,)
    chunk_id: Ints  # (T,)
    chunk_index: Ints  # (T,)
    force_peak: Floats  # (T,) N
    images: tuple[
        bytes, ...
    ] = ()  # (T + 1) JPEG of every observation, the last of the end; none without a camera

    @property
    def n_steps(self) -> int:
        return len(self.reward)

    @property
    def outcome(self) -> str:
        return OUTCOME_NAMES.get(self.end.outcome, f"outcome {self.end.outcome}")

    @property
    def phase(self) -> str:
        return PHASE_NAMES.get(self.end.phase, f"phase {self.end.phase}")

    @property
    def is_demonstration(self) -> bool:
        return self.end.phase == world_state_t.DEMONSTRATION

    @property
    def is_training(self) -> bool:
        return self.end.phase == world_state_t.TRAINING

    @property
    def is_learnable(self) -> bool:
        """Faulted, discarded and evaluation episodes never reach the learner; of demonstrations only successes do."""
        if self.n_steps == 0 or self.end.outcome in (episode_end_t.FAULT, episode_end_t.DISCARD):
            return False
        return self.is_training or (self.is_demonstration and self.end.outcome == episode_end_t.SUCCESS)

    @staticmethod
    def from_messages(steps: list[episode_step_t], end: episode_end_t) -> Episode:
        """Steps 0 .. end.n_steps - 1 in order. Raises ValueError with a sentence when the parts do not agree."""
        if len(steps) != end.n_steps:
            raise ValueError(f"Episode {end.episode} has {len(steps)} steps, its end says {end.n_steps}.")
        widths = sorted({step.n_observation for step in steps})
        if len(widths) > 1:
            raise ValueError(f"Episode {end.episode} mixes observations of {widths} numbers; all must agree.")

        def floats(name: str, shape: tuple[int, ...]) -> Floats:
            return np.array([getattr(step, name) for step in steps], np.float32).reshape(shape)

        def ints(name: str) -> Ints:
            return np.array([getattr(step, name) for step in steps], np.int64)

        length, width = len(steps), widths[0] if widths else 0
        images = tuple(bytes(step.image) for step in steps)
        if any(images):
            images += (bytes(steps[-1].next_image),)
            if not all(images):
                raise ValueError(
                    f"Episode {end.episode} lacks the image of observation {images.index(b'')} and has others; "
                    "the log is incomplete."
                )
        return Episode(
            number=end.episode,
            end=end,
            observation=floats("observation", (length, width)),
            next_observation=floats("next_observation", (length, width)),
            policy_action=floats("policy_action", (length, 7)),
            human_action=floats("human_action", (length, 7)),
            executed_action=floats("executed_action", (length, 7)),
            alpha=floats("alpha", (length,)),
            intervention=ints("intervention") != 0,
            terminated=ints("terminated") != 0,
            truncated=ints("truncated") != 0,
            reward=floats("reward", (length,)),
            discounted_return=floats("discounted_return", (length,)),
            policy_version=ints("policy_version"),
            chunk_id=ints("chunk_id"),
            chunk_index=ints("chunk_index"),
            force_peak=floats("force_peak", (length,)),
            images=images if any(images) else (),
        )

    def to_messages(self) -> tuple[list[episode_step_t], episode_end_t]:
        """The opposite of from_messages. What an Episode does not keep (times, torque digests) is 0."""
        steps = []
        for t in range(self.n_steps):
            step = episode_step_t()
            step.episode, step.step, step.n_observation = self.number, t, self.observation.shape[1]
            for name in (
                "observation",
                "next_observation",
                "policy_action",
                "human_action",
                "executed_action",
            ):
                setattr(step, name, getattr(self, name)[t].tolist())
            for name in ("alpha", "reward", "discounted_return", "force_peak"):
                setattr(step, name, float(getattr(self, name)[t]))
            names = ("intervention", "terminated", "truncated", "policy_version", "chunk_id", "chunk_index")
            for name in names:
                setattr(step, name, int(getattr(self, name)[t]))
            if self.images:
                step.image, step.n_image = self.images[t], len(self.images[t])
            steps.append(step)
        if self.images:
            steps[-1].next_image, steps[-1].n_next_image = self.images[-1], len(self.images[-1])
        end = episode_end_t.decode(self.end.encode())
        end.episode, end.n_steps = self.number, self.n_steps
        end.steps_sha256 = steps_digest(step.encode() for step in steps)
        return steps, end


def steps_digest(encoded_steps: Iterable[bytes]) -> str:
    """sha256 hex over the encoded EPISODE_STEP messages in step order, bytes exactly as received."""
    digest = hashlib.sha256()
    for data in encoded_steps:
        digest.update(data)
    return digest.hexdigest()


class EpisodeAssembler:
    """Collects steps and ends in any order, with losses and repeats, and yields whole episodes.

    A step that comes again replaces the earlier one: after a crash the controller runs the unfinished episode anew.
    """

    def __init__(self) -> None:
        self._steps: dict[int, dict[int, tuple[episode_step_t, bytes]]] = {}
        self._ends: dict[int, episode_end_t] = {}

    def add_step(self, step: episode_step_t, data: bytes) -> None:
        self._steps.setdefault(step.episode, {})[step.step] = (step, data)

    def add_end(self, end: episode_end_t) -> None:
        self._ends[end.episode] = end

    def ended(self) -> list[int]:
        """Numbers of the episodes that have ended but are not whole yet."""
        return sorted(self._ends)

    def missing_steps(self, number: int) -> list[int]:
        """Steps of an ended episode that have not arrived, in order."""
        have = self._steps.get(number, {})
        if len(have) >= self._ends[number].n_steps and max(have, default=-1) < self._ends[number].n_steps:
            return []
        return [step for step in range(self._ends[number].n_steps) if step not in have]

    def take(self, number: int) -> Episode | None:
        """The episode, once ended and whole; it is then forgotten here. None while parts are missing.

        When all steps are there but the digest differs, the steps are dropped so that all are asked for again.
        """
        end = self._ends.get(number)
        if end is None or self.missing_steps(number):
            return None
        steps = self._steps.get(number, {})
        ordered = [steps[index] for index in range(end.n_steps)]
        if steps_digest(data for _, data in ordered) != end.steps_sha256:
            self._steps.pop(number, None)
            return None
        del self._ends[number]
        self._steps.pop(number, None)
        return Episode.from_messages([step for step, _ in ordered], end)
