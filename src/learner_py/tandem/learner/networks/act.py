"""ACT: a transformer from observation tokens and camera features to a chunk, all h actions at once.

    memory = encoder([latent, tokens ..., features of camera 1 row by row, camera 2 ...])
    chunk  = head(decoder(h learnt queries, memory))

The latent is zero, or drawn when `sample_latent` is set; no network infers it from actions (see `imitation_error`).
LeRobot's and the original ACT's inference, post-norm.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from pydantic import Field, model_validator

from tandem.learner.networks import image, transformer
from tandem.learner.networks.base import Array, Horizon, Images, Params, array
from tandem.learner.networks.image import Camera
from tandem.learner.networks.mlp import OUTPUT_GAIN
from tandem.learner.networks.transformer import dense

LATENTS_TRIED = 4  # for each row that is imitated


class Config(transformer.Stack):
    horizon: Horizon
    latent_size: Annotated[int, Field(ge=1, le=1024)]
    sample_latent: bool
    cameras: Annotated[tuple[Camera, ...], Field(max_length=8, strict=False)]
    backbone: image.Backbone | None
    output: Literal["tanh", "linear"]

    @model_validator(mode="after")
    def _parts_fit(self) -> Config:
        if bool(self.cameras) != (self.backbone is not None):
            raise ValueError("cameras need a backbone, and a backbone needs cameras")
        if self.cameras and self.model_size % 4:
            raise ValueError(f"model_size is {self.model_size}; positions of cameras need a multiple of 4")
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"cameras are {names}; their names must differ")
        return self


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    size = config.model_size
    params: dict[str, Any] = {
        "latent": transformer.init_dense(generator, config.latent_size, size),
        "tokens": transformer.init_tokens(generator, config, n_observation),
        "token_position": transformer.init_position(generator, 1 + len(config.tokens), size),
        "encoder": transformer.init_encoder(generator, config),
        "query_position": transformer.init_position(generator, config.horizon, size),
        "decoder": transformer.init_decoder(generator, config),
        "norm": transformer.init_norm(size),
        "action": transformer.init_dense(generator, size, n_axes, OUTPUT_GAIN),
    }
    if config.output == "linear":
        params["output"] = transformer.init_norm(n_axes)
    if config.backbone is not None:
        params["image"] = image.init_pixels()
        params["backbone"] = image.init_backbone(generator, config.backbone)
        params["camera_projection"] = transformer.init_dense(generator, config.backbone.channels, size)
        params["camera_position"] = camera_positions(config)
    return params


def camera_positions(config: Config) -> Params:
    """Camera -> (h' w', d): a fixed table, kept in the file so that whoever runs the policy needs no formula."""
    return {
        camera.name: array(
            image.sine_positions(*image.feature_size(config.backbone, camera), config.model_size)
        )
        for camera in config.cameras
    }


def noise_size(config: Config, n_axes: int) -> int:
    return config.latent_size if config.sample_latent else 0


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, L) or (B, 0), images (B, H, W, 3) uint8 -> chunks (B, h, A).

    output tanh: in [-1, 1]; linear: in the units of output.scale and output.offset.
    """
    latent = noise if config.sample_latent else jnp.zeros((len(x), config.latent_size))
    first = [dense(params["latent"], latent)]
    first += transformer.embed_tokens(params["tokens"], config, x)
    tokens, positions = [jnp.stack(first, axis=1)], [params["token_position"]]
    for camera in config.cameras:
        pixels = image.normalise_pixels(params["image"], images[camera.name])
        seen = image.features(params["backbone"], config.backbone, pixels)
        tokens.append(dense(params["camera_projection"], seen.reshape(len(x), -1, seen.shape[-1])))
        positions.append(params["camera_position"][camera.name])
    position = jnp.concatenate(positions)  # (T, d)
    memory = transformer.encode(params["encoder"], config, jnp.concatenate(tokens, axis=1), position)
    nothing = jnp.zeros((len(x), config.horizon, config.model_size))
    query_position = params["query_position"]
    decoded = transformer.decode(params["decoder"], config, nothing, query_position, memory, position)
    action = dense(params["action"], transformer.layer_norm(params["norm"], decoded))
    if config.output == "tanh":
        return jnp.tanh(action)
    return action * params["output"]["scale"] + params["output"]["offset"]


def imitation_error(params: Params, config: Config, x: Array, target: Array, key: Array) -> Array:
    """Squared error (B, h, A) of the chunk. No images.

    With `sample_latent`, of the nearest of LATENTS_TRIED chunks (implicit maximum likelihood, Li and Malik 2018): some
    latent must lead to every target. A latent drawn once for each target would come to mean nothing, and all samples
    to be their mean.
    """
    if not config.sample_latent:
        return jnp.square(chunk(params, config, x, jnp.zeros((len(x), 0)), {}) - target)
    latents = jax.random.normal(key, (LATENTS_TRIED, len(x), config.latent_size))
    rows, flat = jnp.tile(x, (LATENTS_TRIED, 1)), latents.reshape(-1, config.latent_size)
    tried = chunk(lax.stop_gradient(params), config, rows, flat, {})
    distance = jnp.square(tried.reshape(LATENTS_TRIED, *target.shape) - target).sum(axis=(2, 3))
    nearest = latents[distance.argmin(axis=0), jnp.arange(len(x))]
    return jnp.square(chunk(params, config, x, nearest, {}) - target)
