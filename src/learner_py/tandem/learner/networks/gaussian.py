"""The tanh-Gaussian head: an MLP gives mean and log standard deviation, the noise picks the action.

chunk = tanh(mean + exp(clip(log_std)) noise)        zero noise: the mean action
"""

from __future__ import annotations

import math
from typing import Literal

import jax
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

EDGE = 0.999  # an action at the limit lies infinitely far out before tanh; this is where imitation takes it


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


def imitation_error(params: Params, config: Config, x: Array, target: Array, key: Array) -> Array:
    """Negative log-likelihood (B, h, A) of the target, less its constant."""
    mean, log_std = _moments(params, config, x)
    raw = jnp.arctanh(jnp.clip(target.reshape(len(x), -1), -EDGE, EDGE))
    error = log_std + 0.5 * jnp.square((raw - mean) * jnp.exp(-log_std))
    return error.reshape(target.shape)


def sample_with_log_prob(params: Params, config: HeadConfig, x: Array, key: Array) -> tuple[Array, Array]:
    """A chunk (B, h, A) and its log-density (B,), both with gradients. config: this head's."""
    assert isinstance(config, Config)
    mean, log_std = _moments(params, config, x)
    chunk, log_prob = squashed_log_prob(mean, log_std, jax.random.normal(key, mean.shape))
    return chunk.reshape(len(x), config.horizon, -1), log_prob


def squashed_log_prob(mean: Array, log_std: Array, noise: Array) -> tuple[Array, Array]:
    """tanh(mean + std noise) (B, n), and the log-density (B,) of that point."""
    raw = mean + jnp.exp(log_std) * noise
    normal = -0.5 * jnp.square(noise) - log_std - 0.5 * math.log(2.0 * math.pi)
    stretch = 2.0 * (
        math.log(2.0) - raw - jax.nn.softplus(-2.0 * raw)
    )  # log(1 - tanh(raw)^2), without cancelling
    return jnp.tanh(raw), (normal - stretch).sum(axis=-1)


def _moments(params: Params, config: Config, x: Array) -> tuple[Array, Array]:
    """Mean and log standard deviation before tanh, each (B, h A)."""
    mean, raw = jnp.split(forward(params["layers"], x.T, config.activation).T, 2, axis=1)
    return mean, jnp.clip(raw, config.log_std_min, config.log_std_max)


def squashed_sample(
    layers: Mlp, activation: str, log_std: tuple[float, float], inputs: Array, noise: Array
) -> Array:
    """inputs (B, in), noise (B, n) -> (B, n) in [-1, 1]; the MLP's 2 n outputs are the means, then the log_stds."""
    mean, raw = jnp.split(forward(layers, inputs.T, activation).T, 2, axis=1)
    return jnp.tanh(mean + jnp.exp(jnp.clip(raw, *log_std)) * noise)
