"""Configs of small heads, as JSON has them, and networks without a special number in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from tandem.learner.networks import HEADS, cameras, read_config

Json = dict[str, Any]


def mlp(**changes: Any) -> Json:
    config = {"hidden": [9, 8], "activation": "gelu", "layer_norm": True, "horizon": 3, "output": "tanh"}
    return config | changes


def gaussian(**changes: Any) -> Json:
    return mlp(log_std_min=-5.0, log_std_max=2.0) | changes


def flow(**changes: Any) -> Json:
    return mlp(field="mlp", steps=4, time_features=6, output="clip") | changes


def stack(**changes: Any) -> Json:
    config = {
        "model_size": 12, "heads": 3, "feedforward": 17, "encoder_layers": 2, "decoder_layers": 2,
        "activation": "relu", "tokens": [{"name": "arm", "size": 3}, {"name": "world", "size": 4}], "horizon": 3,
    }  # fmt: skip
    return config | changes


def flow_transformer(**changes: Any) -> Json:
    return stack(field="transformer", steps=4, time_features=6, output="clip") | changes


def act(**changes: Any) -> Json:
    config = stack(latent_size=5, sample_latent=False, cameras=[], backbone=None, output="linear")
    return config | changes


CAMERAS = [{"name": "top", "height": 24, "width": 31}, {"name": "wrist", "height": 17, "width": 16}]
CNN = {
    "kind": "cnn",
    "layers": [{"channels": 6, "kernel": 5, "stride": 3}, {"channels": 7, "kernel": 3, "stride": 2}],
}


def best_of_n(heads: list[tuple[str, Json, int]], edit: bool = True, **critic: Any) -> Json:
    edit_config = {"hidden": [8], "activation": "tanh", "layer_norm": True, "scale": 0.05}
    return {
        "horizon": 3,
        "heads": [{"architecture": name, "config": config, "samples": n} for name, config, n in heads],
        "edit": edit_config | {"log_std_min": -5.0, "log_std_max": 2.0} if edit else None,
        "critic": {
            "hidden": [11],
            "activation": "relu",
            "layer_norm": True,
            "members": 3,
            "aggregate": "mean",
        }
        | critic,
    }


def grasp(architecture: str, config: Json, **critic: Any) -> Json:
    critic = {"hidden": [11], "activation": "relu", "layer_norm": True} | critic
    return {"head": {"architecture": architecture, "config": config}, "critic": critic}


def encoded(architecture: str, config: Json, cameras: list[Json], backbone: Json, features: int) -> Json:
    head = {"architecture": architecture, "config": config}
    return {"cameras": cameras, "backbone": backbone, "features": features, "head": head}


def network(
    architecture: str, config: Json, n_observation: int, n_axes: int, seed: int = 0
) -> tuple[Any, Any]:
    """The head's typed config, and parameters (NumPy) of which none is zero, one, or too small to matter."""
    typed = read_config(architecture, config)
    generator = np.random.default_rng(seed)

    def stir(path: Any, array: jax.Array) -> np.ndarray:
        fan_in = np.prod(array.shape[1:]) if array.ndim > 1 else 10.0
        stirred = np.asarray(array) + 0.3 * fan_in**-0.5 * generator.standard_normal(array.shape)
        return (abs(stirred) + 0.1 if path[-1].key == "running_var" else stirred).astype(np.float32)

    start = HEADS[architecture].init(generator, typed, n_observation, n_axes)
    return typed, jax.tree_util.tree_map_with_path(stir, start)


def inputs(
    architecture: str, typed: Any, n: int, n_observation: int, n_axes: int, seed: int = 1
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """x (n, O), noise (n, noise_size), images."""
    generator = np.random.default_rng(seed)
    size = HEADS[architecture].noise_size(typed, n_axes)
    images = {c.name: generator.integers(0, 256, (n, c.height, c.width, 3), np.uint8) for c in cameras(typed)}
    x, noise = (generator.standard_normal((n, wide), np.float32) for wide in (n_observation, size))
    return x, noise, images


def jitted(function: Callable[..., Any], static: int = 1) -> Callable[..., Any]:
    """Compiled without optimisation: tests compile longer than they compute."""
    return jax.jit(function, static_argnums=static, compiler_options={"xla_backend_optimization_level": 0})
