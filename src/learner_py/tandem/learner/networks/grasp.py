"""Another head moves the arm, and a critic of its own decides the gripper, the last axis (HIL-SERL's grasp critic).

worth   critic(x): what an open hand is worth, and a closed one
chunk   [the head's axes, 1 (closed) where that is worth more, -1 (open) elsewhere], the same throughout
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from tandem.learner.networks.base import Activation, Array, HeadConfig, Hidden, Images, Params
from tandem.learner.networks.best_of_n import SingleHead
from tandem.learner.networks.mlp import Mlp, forward, init_mlp

OPEN, CLOSED = 0, 1  # outputs of the critic


class Critic(HeadConfig):
    hidden: Hidden
    activation: Activation
    layer_norm: bool


class Config(HeadConfig):
    head: SingleHead
    critic: Critic

    @property
    def horizon(self) -> int:
        horizon: int = self.head.config.horizon  # type: ignore[attr-defined]  # all heads have one
        return horizon


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    params: dict[str, Any] = {
        "actor": config.head.head.init(generator, config.head.config, n_observation, n_axes - 1),
        "grasp": init_critic(generator, config.critic, n_observation),
    }
    return params


def noise_size(config: Config, n_axes: int) -> int:
    size: int = config.head.head.noise_size(config.head.config, n_axes - 1)
    return size


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, noise_size), images -> chunks (B, h, A)."""
    of_arm = config.head.head.chunk(params["actor"], config.head.config, x, noise, images)
    value = worth(params["grasp"]["layers"], config.critic.activation, x)
    gripper = jnp.where(value[CLOSED] > value[OPEN], 1.0, -1.0)
    gripper = jnp.where(jnp.isfinite(value).all(axis=0), gripper, jnp.nan)
    throughout = jnp.broadcast_to(gripper[:, None, None], (*of_arm.shape[:2], 1))
    return jnp.concatenate([of_arm, throughout], axis=2)


# ---- the critic


def init_critic(generator: np.random.Generator, config: Critic, n_observation: int) -> Params:
    sizes = [n_observation, *config.hidden, 2]
    return {"layers": init_mlp(generator, sizes, config.layer_norm, output_gain=1.0)}


def worth(layers: Mlp, activation: str, x: Array) -> Array:
    """(2, B): of an open and a closed hand at normalised observations (B, O)."""
    return forward(layers, x.T, activation)
