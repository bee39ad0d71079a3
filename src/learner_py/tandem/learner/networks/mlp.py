"""The MLP: a head (chunk = tanh of its output), and, M times side by side, the critic ensemble.

Activations are features first, (F, B): LayerNorm then sums over the leading axis, which the CPU vectorises over the
batch (one critic step took 3.9 ms so, 4.9 ms batch first, on a busy machine).
Weights are (out, in) as in the policy file.
LayerNorm acts on the pre-activation, y = act(LN(W x + b)), eps 1e-6, biased variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from tandem.learner.networks.base import (
    ACTIVATIONS,
    Activation,
    Array,
    HeadConfig,
    Hidden,
    Horizon,
    Images,
    Params,
    array,
    ones,
    zeros,
)

Layer = dict[str, Array]  # weight (out, in), bias (out); with LayerNorm also norm_scale, norm_offset (out)
Mlp = list[Layer]

NORM_EPSILON = 1e-6
OUTPUT_GAIN = 0.1  # a small output layer: the first actions are near zero, which is "hold"


class Config(HeadConfig):
    hidden: Hidden
    activation: Activation
    layer_norm: bool
    horizon: Horizon
    output: Literal["tanh"] = "tanh"


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    sizes = [n_observation, *config.hidden, config.horizon * n_axes]
    return {"layers": init_mlp(generator, sizes, config.layer_norm, OUTPUT_GAIN)}


def noise_size(config: Config, n_axes: int) -> int:
    return 0


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O) -> chunks (B, h, A) in [-1, 1]. No noise (B, 0), no images."""
    output = jnp.tanh(forward(params["layers"], x.T, config.activation)).T
    return output.reshape(x.shape[0], config.horizon, -1)


def imitation_error(params: Params, config: Config, x: Array, target: Array, key: Array) -> Array:
    """Squared error (B, h, A) of the chunk."""
    return jnp.square(chunk(params, config, x, jnp.zeros((len(x), 0)), {}) - target)


# ---- layers


def init_mlp(
    generator: np.random.Generator, sizes: Sequence[int], layer_norm: bool, output_gain: float
) -> Mlp:
    """sizes: input, hidden ..., output. He-normal hidden layers, the output layer smaller by `output_gain`.

    Drawn by NumPy: compiling JAX's normal numbers takes longer than some trainings.
    """
    layers: Mlp = []
    for index, (n_in, n_out) in enumerate(pairwise(sizes)):
        is_output = index == len(sizes) - 2
        deviation = output_gain * n_in**-0.5 if is_output else (2.0 / n_in) ** 0.5
        weight = deviation * generator.standard_normal((n_out, n_in))
        layer = {"weight": array(weight), "bias": zeros(n_out)}
        if layer_norm and not is_output:
            layer |= {"norm_scale": ones(n_out), "norm_offset": zeros(n_out)}
        layers.append(layer)
    return layers


def forward(layers: Mlp, x: Array, activation: str) -> Array:
    """(in, B) -> (out, B); hidden layers activated, the output layer linear."""
    return layers[-1]["weight"] @ features(layers, x, activation) + layers[-1]["bias"][:, None]


def features(layers: Mlp, x: Array, activation: str) -> Array:
    """(in, B) -> (F, B): what the output layer sees."""
    act = ACTIVATIONS[activation]
    for layer in layers[:-1]:
        x = act(_hidden(layer, x))
    return x


def _hidden(layer: Layer, x: Array) -> Array:
    """Pre-activation (out, B) of a hidden layer, normalised over its features when it has a norm."""
    weight, bias = layer["weight"], layer["bias"]
    if "norm_scale" not in layer:
        return weight @ x + bias[:, None]
    # centring the weights centres their output: one pass over (out, B) less than subtracting the mean afterwards
    y = (weight - weight.mean(0)) @ x + (bias - bias.mean())[:, None]
    y = y * lax.rsqrt(jnp.mean(jnp.square(y), axis=0) + NORM_EPSILON)
    return y * layer["norm_scale"][:, None] + layer["norm_offset"][:, None]


def init_ensemble(generator: np.random.Generator, members: int, sizes: Sequence[int]) -> Mlp:
    """M critics, each with its own start; every array has a leading axis M."""
    critics = [init_mlp(generator, sizes, layer_norm=True, output_gain=1.0) for _ in range(members)]
    return jax.tree.map(lambda *arrays: jnp.stack(arrays), *critics)


def ensemble_values(layers: Mlp, x: Array, chunk: Array, activation: str = "relu") -> Array:
    """Values (M, B) of chunks (B, h, A) at normalised observations (B, O), one row a member."""
    inputs = jnp.concatenate([x, chunk.reshape(x.shape[0], -1)], axis=1).T  # (O + h A, B)
    return jax.vmap(lambda member: forward(member, inputs, activation)[0])(layers)
