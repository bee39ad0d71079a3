"""The policies' networks, one module a head:

    Config       frozen pydantic; its JSON dump is the policy file's "config"
    init         (generator, config, O, A) -> params: dicts and lists of arrays, whose path is the tensor's name
    noise_size   (config, A) -> how many normal numbers a chunk takes
    chunk        (params, config, x (B, O) normalised, noise (B, noise_size), images) -> (B, h, A); to be jitted
    imitation_error  (params, config, x, target (B, h, A), key) -> (B, h, A): what imitation makes small (single heads)

`encoded` puts an image encoder in front of any of them. The C++ runtime computes the same from a policy file. A new
head is a module here and its name in SINGLE_HEADS.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

from pydantic import TypeAdapter

from tandem.learner.networks import act, best_of_n, encoded, grasp
from tandem.learner.networks.base import Array, HeadConfig, Params
from tandem.learner.networks.image import Camera
from tandem.learner.networks.mlp import Mlp, ensemble_values, init_ensemble, init_mlp

__all__ = [
    "HEADS",
    "Array",
    "Camera",
    "HeadConfig",
    "Mlp",
    "Params",
    "cameras",
    "encoded",
    "ensemble_values",
    "grasp",
    "init_ensemble",
    "init_mlp",
    "read_config",
]

HEADS: dict[str, ModuleType] = {**encoded.HEADS, "encoded": encoded}


def read_config(architecture: str, value: Any) -> Any:
    """The config of a policy file as the head's type. Raises pydantic.ValidationError."""
    return TypeAdapter(HEADS[architecture].Config).validate_python(value)


def cameras(config: HeadConfig) -> tuple[Camera, ...]:
    """The images that a head looks at; each once, if heads of a best of N share it."""
    if isinstance(config, encoded.Config):
        return config.cameras
    if isinstance(config, best_of_n.Config):
        return tuple(dict.fromkeys(camera for part in config.heads for camera in cameras(part.config)))
    if isinstance(config, grasp.Config):
        return cameras(config.head.config)
    return config.cameras if isinstance(config, act.Config) else ()
