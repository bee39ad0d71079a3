"""An image encoder in front of any other head: the head sees the observation and, behind it, F features.

    features = tanh(norm(W [map of camera 1, map of camera 2 ...] + b))       chunk = head([x, features])

The maps are a backbone's, flattened row by row. In training, `encode` is what actor and critics look through: one
encoder for all of them.
"""

from __future__ import annotations

from types import ModuleType
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jax import lax
from pydantic import Field, SerializeAsAny, TypeAdapter, ValidationInfo, field_validator

from tandem.learner.networks import best_of_n, grasp, image
from tandem.learner.networks.base import Array, HeadConfig, Images, Params, array, ones, zeros
from tandem.learner.networks.image import Camera
from tandem.learner.networks.mlp import NORM_EPSILON

HEADS: dict[str, ModuleType] = {**best_of_n.SINGLE_HEADS, "best_of_n": best_of_n, "grasp": grasp}
COMPOSED = ("best_of_n", "grasp")  # their parts have names of their own


class Sight(HeadConfig):
    """The encoder alone."""

    cameras: Annotated[tuple[Camera, ...], Field(min_length=1, max_length=8, strict=False)]
    backbone: image.Backbone
    features: Annotated[int, Field(ge=1, le=4096)]

    @field_validator("cameras")
    @classmethod
    def _names_differ(cls, cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
        names = [camera.name for camera in cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"cameras are {names}; their names must differ")
        return cameras

    @property
    def flat_size(self) -> int:
        sizes = [image.feature_size(self.backbone, camera) for camera in self.cameras]
        return sum(height * width * self.backbone.channels for height, width in sizes)


class Inner(HeadConfig):
    """The head behind the encoder."""

    architecture: Literal["mlp", "gaussian", "flow", "act", "best_of_n", "grasp"]
    config: SerializeAsAny[HeadConfig]

    @field_validator("config", mode="before")
    @classmethod
    def _of_the_architecture(cls, value: Any, info: ValidationInfo) -> Any:
        if "architecture" not in info.data:
            return value  # refused already
        kind: Any = HEADS[info.data["architecture"]].Config
        return TypeAdapter(kind).validate_python(value)

    @property
    def head(self) -> ModuleType:
        return HEADS[self.architecture]


class Config(Sight):
    head: Inner

    @property
    def horizon(self) -> int:
        horizon: int = self.head.config.horizon  # type: ignore[attr-defined]  # all heads have one
        return horizon


def init(generator: np.random.Generator, config: Config, n_observation: int, n_axes: int) -> Params:
    inner = config.head.head.init(generator, config.head.config, n_observation + config.features, n_axes)
    return together(init_encoder(generator, config), config, inner)


def together(encoder: Params, config: Config, inner: Params) -> Params:
    """Parameters of the whole, named as in the policy file."""
    return {"encoder": encoder, **(inner if config.head.architecture in COMPOSED else {"actor": inner})}


def parts(params: Params, config: Config) -> tuple[Params, Params]:
    """The encoder's parameters, and the head's."""
    if config.head.architecture not in COMPOSED:
        return params["encoder"], params["actor"]
    return params["encoder"], {name: part for name, part in params.items() if name != "encoder"}


def noise_size(config: Config, n_axes: int) -> int:
    size: int = config.head.head.noise_size(config.head.config, n_axes)
    return size


def chunk(params: Params, config: Config, x: Array, noise: Array, images: Images) -> Array:
    """Normalised observations (B, O), noise (B, noise_size), images (B, H, W, 3) uint8 -> chunks (B, h, A)."""
    encoder, inner = parts(params, config)
    seen = encode(encoder, config, x, images)
    chunks: Array = config.head.head.chunk(inner, config.head.config, seen, noise, images)
    return chunks


# ---- the encoder


def init_encoder(generator: np.random.Generator, sight: Sight) -> Params:
    weight = sight.flat_size**-0.5 * generator.standard_normal((sight.features, sight.flat_size))
    projection = {
        "weight": array(weight),
        "bias": zeros(sight.features),
        "norm_scale": ones(sight.features),
        "norm_offset": zeros(sight.features),
    }
    return {
        "image": image.init_pixels(),
        "backbone": image.init_backbone(generator, sight.backbone),
        "projection": projection,
    }


def encode(params: Params, sight: Sight, x: Array, images: Images) -> Array:
    """Normalised observations (B, O), images (B, H, W, 3) uint8 -> (B, O + F): what the networks behind it see."""
    maps = []
    for camera in sight.cameras:
        # statistics of pixels are not learnt
        pixels = image.normalise_pixels(lax.stop_gradient(params["image"]), images[camera.name])
        maps.append(image.features(params["backbone"], sight.backbone, pixels).reshape(len(x), -1))
    projection = params["projection"]
    y = jnp.concatenate(maps, axis=1) @ projection["weight"].T + projection["bias"]
    y = y - y.mean(axis=1, keepdims=True)
    y = y * lax.rsqrt(jnp.mean(jnp.square(y), axis=1, keepdims=True) + NORM_EPSILON)
    features = jnp.tanh(y * projection["norm_scale"] + projection["norm_offset"])
    return jnp.concatenate([x, features], axis=1)
