"""Transformer layers after ACT: LayerNorm behind each sum (post-norm), positions added to queries and keys only.

Batch first: tokens are (B, T, d). Weights are (out, in) as in the policy file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from pydantic import Field, model_validator

from tandem.learner.networks.base import ACTIVATIONS, Array, HeadConfig, Params, array, ones, zeros

NORM_EPSILON = 1e-5  # PyTorch's, so that LeRobot's policies can be taken over


class Token(HeadConfig):
    """A slice of the observation vector that enters as one token."""

    name: Annotated[str, Field(min_length=1)]
    size: Annotated[int, Field(ge=1, le=4096)]


class Stack(HeadConfig):
    """Sizes of an encoder and a decoder."""

    model_size: Annotated[int, Field(ge=1, le=4096)]
    heads: Annotated[int, Field(ge=1, le=64)]
    feedforward: Annotated[int, Field(ge=1, le=16384)]
    encoder_layers: Annotated[int, Field(ge=1, le=16)]
    decoder_layers: Annotated[int, Field(ge=1, le=16)]
    activation: Literal["relu", "gelu"]
    tokens: Annotated[tuple[Token, ...], Field(min_length=1, max_length=64, strict=False)]

    @model_validator(mode="after")
    def _heads_divide_the_model(self) -> Stack:
        if self.model_size % self.heads:
            raise ValueError(
                f"model_size is {self.model_size}; it must be a multiple of heads = {self.heads}"
            )
        return self


# ---- start values


def init_dense(generator: np.random.Generator, n_in: int, n_out: int, gain: float = 1.0) -> Params:
    weight = gain * (2.0 / (n_in + n_out)) ** 0.5 * generator.standard_normal((n_out, n_in))
    return {"weight": array(weight), "bias": zeros(n_out)}


def init_position(generator: np.random.Generator, n: int, size: int) -> Array:
    return array(generator.standard_normal((n, size)))


def init_norm(size: int) -> Params:
    return {"scale": ones(size), "offset": zeros(size)}


def init_attention(generator: np.random.Generator, size: int) -> Params:
    return {name: init_dense(generator, size, size) for name in ("query", "key", "value", "output")}


def init_encoder(generator: np.random.Generator, stack: Stack) -> list[Params]:
    size = stack.model_size
    return [
        {
            "attention": init_attention(generator, size),
            "norm1": init_norm(size),
            "feedforward1": init_dense(generator, size, stack.feedforward),
            "feedforward2": init_dense(generator, stack.feedforward, size),
            "norm2": init_norm(size),
        }
        for _ in range(stack.encoder_layers)
    ]


def init_decoder(generator: np.random.Generator, stack: Stack) -> list[Params]:
    size = stack.model_size
    return [
        {
            "self_attention": init_attention(generator, size),
            "norm1": init_norm(size),
            "cross_attention": init_attention(generator, size),
            "norm2": init_norm(size),
            "feedforward1": init_dense(generator, size, stack.feedforward),
            "feedforward2": init_dense(generator, stack.feedforward, size),
            "norm3": init_norm(size),
        }
        for _ in range(stack.decoder_layers)
    ]


# ---- forward


def dense(params: Params, x: Array) -> Array:
    """(..., in) -> (..., out)"""
    return x @ params["weight"].T + params["bias"]


def layer_norm(params: Params, x: Array) -> Array:
    centred = x - x.mean(-1, keepdims=True)
    variance = jnp.square(centred).mean(-1, keepdims=True)
    return centred * lax.rsqrt(variance + NORM_EPSILON) * params["scale"] + params["offset"]


def attention(params: Params, query: Array, key: Array, value: Array, heads: int) -> Array:
    """query (B, Q, d), key and value (B, T, d) -> (B, Q, d)."""

    def split(dense_params: Params, x: Array) -> Array:
        return dense(dense_params, x).reshape(*x.shape[:2], heads, -1)  # (B, T, heads, d / heads)

    q, k, v = split(params["query"], query), split(params["key"], key), split(params["value"], value)
    scores = jnp.einsum("bqhc,bthc->bhqt", q, k) * q.shape[-1] ** -0.5
    mixed = jnp.einsum("bhqt,bthc->bqhc", jax.nn.softmax(scores, axis=-1), v)
    return dense(params["output"], mixed.reshape(query.shape))


def _feedforward(params: Params, x: Array, activation: str) -> Array:
    return dense(params["feedforward2"], ACTIVATIONS[activation](dense(params["feedforward1"], x)))


def encode(layers: Sequence[Params], stack: Stack, x: Array, position: Array) -> Array:
    """Tokens (B, T, d) with positions (T, d) -> memory (B, T, d)."""
    for layer in layers:
        placed = x + position
        x = layer_norm(layer["norm1"], x + attention(layer["attention"], placed, placed, x, stack.heads))
        x = layer_norm(layer["norm2"], x + _feedforward(layer, x, stack.activation))
    return x


def decode(
    layers: Sequence[Params],
    stack: Stack,
    x: Array,
    query_position: Array,
    memory: Array,
    memory_position: Array,
) -> Array:
    """Queries (B, h, d) with positions (h, d) that look at a memory (B, T, d) with positions (T, d) -> (B, h, d)."""
    memory_key = memory + memory_position
    for layer in layers:
        placed = x + query_position
        x = layer_norm(layer["norm1"], x + attention(layer["self_attention"], placed, placed, x, stack.heads))
        seen = attention(layer["cross_attention"], x + query_position, memory_key, memory, stack.heads)
        x = layer_norm(layer["norm2"], x + seen)
        x = layer_norm(layer["norm3"], x + _feedforward(layer, x, stack.activation))
    return x


# ---- observation tokens


def init_tokens(generator: np.random.Generator, stack: Stack, n_observation: int) -> list[Params]:
    total = sum(token.size for token in stack.tokens)
    if total != n_observation:
        raise ValueError(
            f"The tokens' sizes add up to {total}; the observation has {n_observation} numbers. "
            "Let the tokens cover the observation exactly."
        )
    return [init_dense(generator, token.size, stack.model_size) for token in stack.tokens]


def embed_tokens(params: Sequence[Params], stack: Stack, x: Array) -> list[Array]:
    """Observations (B, O), cut into consecutive slices -> one (B, d) for each token."""
    ends = np.cumsum([token.size for token in stack.tokens])
    slices = jnp.split(x, ends[:-1], axis=1)
    return [dense(layer, part) for layer, part in zip(params, slices, strict=True)]
