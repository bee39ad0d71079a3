"""The actor in training: a head of `networks`, chosen by the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from types import ModuleType

import jax
import numpy as np

from tandem.learner.config import Head
from tandem.learner.networks import HEADS, Array, HeadConfig, Params, read_config


@dataclass(frozen=True)
class Actor:
    architecture: str
    config: HeadConfig
    n_observation: int
    n_axes: int

    @property
    def head(self) -> ModuleType:
        return HEADS[self.architecture]

    def init(self, generator: np.random.Generator) -> Params:
        return self.head.init(generator, self.config, self.n_observation, self.n_axes)

    def sample(self, params: Params, x: Array, key: Array) -> Array:
        """One chunk (B, h, A) for each normalised observation (B, O), as the arm would execute it."""
        noise = jax.random.normal(key, (len(x), self.head.noise_size(self.config, self.n_axes)))
        return self.head.chunk(params, self.config, x, noise, {})

    def imitation_loss(self, params: Params, x: Array, target: Array, weight: Array, key: Array) -> Array:
        """Mean over batch, steps and axes of weight (B, h) x error; masked steps count as zero error.

        Dividing by all elements, not by the weights, gives every real action the same say wherever it stands.
        """
        error = self.head.imitation_error(params, self.config, x, target, key)
        return (error * weight[:, :, None]).mean()


def make_actor(head: Head, horizon: int, observation: Sequence[str], n_axes: int) -> Actor:
    """observation: names; ACT reads those of one kind (goal_x, goal_y ...) as one token."""
    settings = getattr(head, head.kind).model_dump()
    if head.kind == "flow":
        settings["field"] = "mlp"
    if head.kind == "act":
        kinds = [
            (kind, len(list(names)))
            for kind, names in groupby(observation, lambda n: n.rpartition("_")[0] or n)
        ]
        settings |= {"tokens": [{"name": kind, "size": size} for kind, size in kinds]}
        settings |= {"cameras": [], "backbone": None, "output": "tanh"}
    return Actor(
        head.kind, read_config(head.kind, {**settings, "horizon": horizon}), len(observation), n_axes
    )
