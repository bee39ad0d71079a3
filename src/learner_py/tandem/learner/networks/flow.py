"""Flow: a chunk grows out of noise along a learnt velocity field, in K Euler steps.

    a = noise;  for k = 0 .. K-1:  a += v(x, a, k / K) / K;  chunk = clip(a, -1, 1)

The field is an MLP of [x, a, phi(t)], or a transformer whose memory of the observation is made once for all steps.
phi(t) = cos(pi i t) for i = 1 .. F/2, then sin(pi i t).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from pydantic import Field

from tandem.learner.networks import transformer
from tandem.learner.networks.base import Activation, Array, HeadConfig, Hidden, Horizon, Images, Params
from tandem.learner.networks.mlp import OUTPUT_GAIN, forward, init_mlp
from tandem.learner.networks.transformer import dense

Steps = Annotated[int, Field(ge=1, le=100)]
TimeFeatures = Annotated[int, Field(ge=2, le=256, multiple_of=2)]


class MlpConfig(HeadConfig):
    field: Literal["mlp"] = "mlp"
    hidden: Hidden
    activation: Activation
    layer_norm: bool
    horizon: Horizon
    steps: Steps
    time_features: TimeFeatures
    output: Literal["clip"] = "clip"


class TransformerConfig(transformer.Stack):
    field: Literal["transformer"] = "transformer"
    horizon: Horizon
    steps: Steps
    time_features: TimeFeatures
    output: Literal["clip"] = "clip"


AnyConfig = MlpConfig | TransformerConfig
Velocity = Callable[
    [Array, Array], Array
]  # (action (B, h, A), phi (F) or (F, B)) -> (B, h, A), at given observations
Config = Annotated[AnyConfig, Field(discriminator="field")]


def init(generator: np.random.Generator, config: AnyConfig, n_observation: int, n_axes: int) -> Params:
    if isinstance(config, MlpConfig):
        n_chunk = config.horizon * n_axes
        sizes = [n_observation + n_chunk + config.time_features, *config.hidden, n_chunk]
        return {"layers": init_mlp(generator, sizes, config.layer_norm, OUTPUT_GAIN)}
    size = config.model_size
    return {
        "tokens": transformer.init_tokens(generator, config, n_observation),
        "token_position": transformer.init_position(generator, len(config.tokens), size),
        "encoder": transformer.init_encoder(generator, config),
        "action": transformer.init_dense(generator, n_axes, size),
        "time": {"weight": transformer.init_dense(generator, config.time_features, size)["weight"]},
        "query_position": transformer.init_position(generator, config.horizon, size),
        "decoder": transformer.init_decoder(generator, config),
        "norm": transformer.init_norm(size),
        "output": transformer.init_dense(generator, size, n_axes, OUTPUT_GAIN),
    }


def noise_size(config: AnyConfig, n_axes: int) -> int:
    return config.horizon * n_axes


def chunk(params: Params, config: AnyConfig, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, h A) -> chunks (B, h, A) in [-1, 1]. No images."""
    make_field: Any = _mlp_field if isinstance(config, MlpConfig) else _transformer_field
    velocity: Velocity = make_field(params, config, x)

    def step(action: Array, phi: Array) -> tuple[Array, None]:
        return action + velocity(action, phi) / config.steps, None

    start = noise.reshape(len(x), config.horizon, -1)
    end, _ = lax.scan(step, start, jnp.asarray(time_features(config.steps, config.time_features)))
    return jnp.clip(end, -1.0, 1.0)


def imitation_error(params: Params, config: AnyConfig, x: Array, target: Array, key: Array) -> Array:
    """Flow matching (B, h, A): at a = (1 - t) noise + t target, t uniform, the velocity should be target - noise."""
    make_field: Any = _mlp_field if isinstance(config, MlpConfig) else _transformer_field
    velocity: Velocity = make_field(params, config, x)
    key_noise, key_time = jax.random.split(key)
    noise = jax.random.normal(key_noise, target.shape)
    time = jax.random.uniform(key_time, (len(x),))
    action = noise + time[:, None, None] * (target - noise)
    return jnp.square(velocity(action, features_at(time, config.time_features)) - (target - noise))


def features_at(time: Array, size: int) -> Array:
    """phi (F, B) at times (B,)."""
    angle = math.pi * jnp.arange(1, size // 2 + 1)[:, None] * time
    return jnp.concatenate([jnp.cos(angle), jnp.sin(angle)])


def time_features(steps: int, size: int) -> np.ndarray:
    """phi of every step's time k / K: (K, F)."""
    angle = math.pi * np.outer(np.arange(steps) / steps, np.arange(1, size // 2 + 1))
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)


def _mlp_field(params: Params, config: MlpConfig, x: Array) -> Velocity:
    def velocity(action: Array, phi: Array) -> Array:
        phis = phi if phi.ndim == 2 else jnp.broadcast_to(phi[:, None], (len(phi), len(x)))
        inputs = jnp.concatenate([x.T, action.reshape(len(x), -1).T, phis])  # (O + h A + F, B)
        return forward(params["layers"], inputs, config.activation).T.reshape(action.shape)

    return velocity


def _transformer_field(params: Params, config: TransformerConfig, x: Array) -> Velocity:
    tokens = jnp.stack(transformer.embed_tokens(params["tokens"], config, x), axis=1)
    position, query = params["token_position"], params["query_position"]
    memory = transformer.encode(params["encoder"], config, tokens, position)

    def velocity(action: Array, phi: Array) -> Array:
        phis = (params["time"]["weight"] @ phi).T  # (d) or (B, d)
        y = dense(params["action"], action) + query + (phis[:, None] if phis.ndim == 2 else phis)
        y = transformer.decode(params["decoder"], config, y, query, memory, position)
        return dense(params["output"], transformer.layer_norm(params["norm"], y))

    return velocity
