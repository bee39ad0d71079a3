"""Best of N: heads propose chunks, an edit network may vary each of them, a critic ensemble picks the winner.

    candidates  samples of every head, head after head; then, with an edit network, an edited copy of each
    score       mean or minimum over the ensemble of critic([x, chunk])
    winner      the highest score; ties go to the first, a score that is not finite never wins

Noise: for each head in order its samples one after the other, then one chunk for each edit.
"""

from __future__ import annotations

from types import ModuleType
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, SerializeAsAny, TypeAdapter, ValidationInfo, field_validator, model_validator

from tandem.learner.networks import act, flow, gaussian, mlp
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
from tandem.learner.networks.gaussian import squashed_sample
from tandem.learner.networks.mlp import OUTPUT_GAIN, Mlp, ensemble_values, init_mlp

SINGLE_HEADS: dict[str, ModuleType] = {"mlp": mlp, "gaussian": gaussian, "flow": flow, "act": act}


class SingleHead(HeadConfig):
    """A head that is not made of others."""

    architecture: Literal["mlp", "gaussian", "flow", "act"]
    config: SerializeAsAny[HeadConfig]

    @field_validator("config", mode="before")
    @classmethod
    def _of_the_architecture(cls, value: Any, info: ValidationInfo) -> Any:
        if "architecture" not in info.data:
            return value  # refused already
        kind: Any = SINGLE_HEADS[info.data["architecture"]].Config
        return TypeAdapter(kind).validate_python(value)

    @property
    def head(self) -> ModuleType:
        return SINGLE_HEADS[self.architecture]


class Proposer(SingleHead):
    """A head and how many samples of it."""

    samples: Annotated[int, Field(ge=1, le=256)]


class Edit(HeadConfig):
    """A tanh-Gaussian MLP of [x, chunk] whose sample, scaled, is added to the chunk."""

    hidden: Hidden
    activation: Activation
    layer_norm: bool
    scale: Annotated[float, Field(gt=0, le=1)]
    log_std_min: LogStd
    log_std_max: LogStd


class Critic(HeadConfig):
    hidden: Hidden
    activation: Activation
    layer_norm: bool
    members: Annotated[int, Field(ge=1, le=32)]
    aggregate: Literal["mean", "min"]


class Config(HeadConfig):
    horizon: Horizon
    heads: Annotated[tuple[Proposer, ...], Field(min_length=1, max_length=8, strict=False)]
    edit: Edit | None
    critic: Critic

    @model_validator(mode="after")
    def _heads_fit(self) -> Config:
        for index, proposer in enumerate(self.heads):
            horizon = getattr(proposer.config, "horizon", None)
            if horizon != self.horizon:
                raise ValueError(f"heads.{index}.config.horizon is {horizon}; all heads have {self.horizon}")
        return self

    @property
    def samples(self) -> int:
        """Candidates before the edits."""
        return sum(proposer.samples for proposer in self.heads)


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    n_chunk = config.horizon * n_axes
    params: dict[str, Any] = {
        "actor": [
            proposer.head.init(generator, proposer.config, n_observation, n_axes) for proposer in config.heads
        ]
    }
    n_in = n_observation + n_chunk
    if config.edit is not None:
        sizes = [n_in, *config.edit.hidden, 2 * n_chunk]
        params["edit"] = {"layers": init_mlp(generator, sizes, config.edit.layer_norm, OUTPUT_GAIN)}
    sizes = [n_in, *config.critic.hidden, 1]
    params["critic"] = [
        {"layers": init_mlp(generator, sizes, config.critic.layer_norm, output_gain=1.0)}
        for _ in range(config.critic.members)
    ]
    return params


def noise_size(config: Config, n_axes: int) -> int:
    drawn = sum(p.samples * p.head.noise_size(p.config, n_axes) for p in config.heads)
    return drawn + (config.samples * config.horizon * n_axes if config.edit is not None else 0)


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, noise_size), images -> the winning chunks (B, h, A)."""
    proposed = candidates(params, config, x, noise, images)
    return choose(scores(stacked(params["critic"]), config.critic, x, proposed), proposed)


def candidates(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """(B, N, h, A), in the order that decides ties."""
    n_in = params["critic"][0]["layers"][0]["weight"].shape[1]
    n_axes = (n_in - x.shape[1]) // config.horizon  # a critic sees observation and chunk
    begin, found = 0, []
    for proposer, head_params in zip(config.heads, params["actor"], strict=True):
        n, size = proposer.samples, proposer.head.noise_size(proposer.config, n_axes)
        own = noise[:, begin : begin + n * size].reshape(len(x) * n, size)
        begin += n * size
        repeated = {name: jnp.repeat(image, n, axis=0) for name, image in images.items()}
        chunks = proposer.head.chunk(head_params, proposer.config, jnp.repeat(x, n, axis=0), own, repeated)
        found.append(chunks.reshape(len(x), n, config.horizon, n_axes))
    proposed = jnp.concatenate(found, axis=1)
    if config.edit is None:
        return proposed
    edited = edit(params["edit"], config.edit, x, proposed, noise[:, begin:])
    return jnp.concatenate([proposed, edited], axis=1)


def edit(params: Params, config: Edit, x: Array, proposed: Array, noise: Array) -> Array:
    """An edited copy (B, N, h, A) of each candidate (B, N, h, A); noise (B, N h A)."""
    flat = proposed.reshape(-1, proposed.shape[2] * proposed.shape[3])  # (B N, h A)
    inputs = jnp.concatenate([jnp.repeat(x, proposed.shape[1], axis=0), flat], axis=1)
    limits = (config.log_std_min, config.log_std_max)
    change = squashed_sample(params["layers"], config.activation, limits, inputs, noise.reshape(flat.shape))
    return jnp.clip(flat + config.scale * change, -1.0, 1.0).reshape(proposed.shape)


def stacked(critics: list[Params]) -> Mlp:
    """The members' arrays side by side, with a leading axis M: what `ensemble_values` takes."""
    return jax.tree.map(lambda *arrays: jnp.stack(arrays), *critics)["layers"]


def scores(critic: Mlp, config: Critic, x: Array, proposed: Array) -> Array:
    """Scores (B, N) of candidates (B, N, h, A). critic: stacked, leading axis M."""
    b, n = proposed.shape[:2]
    flat = proposed.reshape(b * n, *proposed.shape[2:])
    values = ensemble_values(critic, jnp.repeat(x, n, axis=0), flat, config.activation).reshape(-1, b, n)
    return values.mean(axis=0) if config.aggregate == "mean" else values.min(axis=0)


def choose(score: Array, proposed: Array) -> Array:
    """Scores (B, N), candidates (B, N, h, A) -> the winners (B, h, A); NaN where no score is finite."""
    usable = jnp.isfinite(score)
    winner = jnp.argmax(jnp.where(usable, score, -jnp.inf), axis=1)  # the first of equals
    chosen = jnp.take_along_axis(proposed, winner[:, None, None, None], axis=1)[:, 0]
    return jnp.where(usable.any(axis=1)[:, None, None], chosen, jnp.nan)
