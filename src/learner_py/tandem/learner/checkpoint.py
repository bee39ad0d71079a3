"""The learner's own checkpoint: RUN/learner/checkpoint.safetensors, whole or not there.

It holds every leaf of the learner state (parameters, EMA, optimisers), the normaliser and the position: through which
episode it has trained, and how many updates into the next one. Random numbers are keyed by (seed, episode, update), so
the seed, which the scenario fixes, is all of the generator's state. The replay buffer is rebuilt from the event log.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from tandem.learner.method import LearnerState
from tandem.learner.normalizer import Normalizer
from tandem.policy_file import encode_safetensors, read_safetensors, write_file

FORMAT = "tandem-learner-1"


class CheckpointError(Exception):
    """A sentence: which checkpoint, why it can't be used, what to do."""


@dataclass
class Position:
    """Where in the stream of episodes the learner is."""

    episodes_trained_through: int = -1
    updates_into_next: int = 0  # updates already done on the episode after that
    version: int = 0  # of the newest policy
    env_steps: int = 0  # training steps, as the controller counts them, through the last trained episode


def save(
    path: Path, state: LearnerState, normalizer: Normalizer | None, position: Position, fingerprint: str
) -> None:
    tensors = _named_leaves(state)
    if normalizer is not None:
        tensors |= {"normalizer.mean": normalizer.mean, "normalizer.scale": normalizer.scale}
    metadata = {"format": FORMAT, "fingerprint": fingerprint, "position": json.dumps(asdict(position))}
    write_file(path, encode_safetensors(tensors, metadata))


def load(
    path: Path, like: LearnerState, fingerprint: str
) -> tuple[LearnerState, Normalizer | None, Position]:
    """`like`: a fresh state of the same method; it gives structure and shapes. Raises CheckpointError."""
    tensors, metadata = read_safetensors(path)
    if metadata.get("format") != FORMAT:
        raise CheckpointError(f"{path} is not a learner checkpoint; delete it to train anew from the log.")
    if metadata["fingerprint"] != fingerprint:
        raise CheckpointError(
            f"{path} was made by another scenario (method, task, seed or demonstrations differ); "
            "use another run folder, or delete it to train anew from the log."
        )
    leaves = []
    for name, leaf in _named_leaves(like).items():
        array = tensors.get(name)
        if array is None or array.shape != leaf.shape or array.dtype != leaf.dtype:
            raise CheckpointError(
                f"{path}: {name} is missing or of another shape; delete it to train anew from the log."
            )
        leaves.append(jnp.asarray(array))
    state = jax.tree.unflatten(jax.tree.structure(like), leaves)
    normalizer = None
    if "normalizer.mean" in tensors:
        normalizer = Normalizer(tensors["normalizer.mean"], tensors["normalizer.scale"])
    return state, normalizer, Position(**json.loads(metadata["position"]))


def _named_leaves(state: LearnerState) -> dict[str, np.ndarray]:
    """Leaves by path, in the order of the tree."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return {f"state{jax.tree_util.keystr(path)}": np.asarray(leaf) for path, leaf in leaves}
