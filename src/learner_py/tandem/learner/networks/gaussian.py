"""The tanh-Gaussian head: an MLP gives mean and log standard deviation, the noise picks the action.

chunk = tanh(mean + exp(clip(log_std)) noise)        zero noise: the mean action
"""

from __future__ import annotations

from typing import Literal

import jax.numpy as jnp
import numpy as np

from tandem.learner.networks.base import (
    Activation,
    Array,
    HeadConfig,
    Hidden,
    Horizon,
    Images,
    LogStd,
    Params,
)
from tandem.learner.networks.mlp import OUTPUT_GAIN, Mlp, forward, init_mlp


class Config(HeadConfig):
    hidden: Hidden
    activation: Activation
    layer_norm: bool
    horizon: Horizon
    log_std_min: LogStd
    log_std_max: LogStd
    output: Literal["tanh"] = "tanh"


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    sizes = [n_observation, *config.hidden, 2 * config.horizon * n_axes]
    return {"layers": init_mlp(generator, sizes, config.layer_norm, OUTPUT_GAIN)}


def noise_size(config: Config, n_axes: int) -> int:
    return config.horizon * n_axes


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, h A) -> chunks (B, h, A) in [-1, 1]. No images."""
    limits = (config.log_std_min, config.log_std_max)
    output = squashed_sample(params["layers"], config.activation, limits, x, noise)
    return output.reshape(len(x), config.horizon, -1)


def squashed_sample(
    layers: Mlp, activation: str, log_std: tuple[float, float], inputs: Array, noise: Array
) -> Array:
    """inputs (B, in), noise (B, n) -> (B, n) in [-1, 1]; the MLP's 2 n outputs are the means, then the log_stds."""
    mean, raw = jnp.split(forward(layers, inputs.T, activation).T, 2, axis=1)
    return jnp.tanh(mean + jnp.exp(jnp.clip(raw, *log_std)) * noise)
