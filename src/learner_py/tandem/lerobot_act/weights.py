"""The weights of LeRobot's ACT by its names -> the parameters of our ACT head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tandem.learner.networks import act
from tandem.learner.networks.base import Params
from tandem.lerobot_act.statistics import Affine
from tandem.policy_file import Array, PolicyFileError

# Only training needs these: the encoder of actions, and older checkpoints' statistics, which are read elsewhere.
LEFT_BEHIND = ("model.vae_encoder", "normalize_inputs.", "normalize_targets.", "unnormalize_outputs.")
LINEARS = {
    "observation.state": "encoder_robot_state_input_proj"
}  # any other token is the environment's state
ENVIRONMENT_LINEAR = "encoder_env_state_input_proj"


class Weights:
    """Tensors that are taken by name and shape; what nobody took is refused in the end."""

    def __init__(self, path: Path, tensors: Mapping[str, Array]) -> None:
        self._path = path
        self._left = dict(tensors)

    def take(self, name: str, *shape: int) -> Array:
        """model.NAME. Raises PolicyFileError when it is missing or of another shape."""
        array = self._left.pop(f"model.{name}", None)
        if array is None:
            raise PolicyFileError(
                f"{self._path}: model.{name} is missing; it is not a checkpoint of LeRobot's ACT."
            )
        if array.shape != shape:
            raise PolicyFileError(
                f"{self._path}: model.{name} has shape {list(array.shape)}; by config.json it must be {list(shape)}."
            )
        return array.astype(np.float32)

    def refuse_unused(self) -> None:
        for name in self._left:
            if not name.startswith(LEFT_BEHIND):
                raise PolicyFileError(
                    f"{self._path}: {name} is unknown; the policy is not LeRobot's plain ACT. Convert it by hand."
                )

    def dense(self, name: str, n_in: int, n_out: int) -> Params:
        return {"weight": self.take(f"{name}.weight", n_out, n_in), "bias": self.take(f"{name}.bias", n_out)}

    def norm(self, name: str, size: int) -> Params:
        return {"scale": self.take(f"{name}.weight", size), "offset": self.take(f"{name}.bias", size)}

    def attention(self, name: str, size: int) -> Params:
        """PyTorch stacks query, key and value."""
        weights = np.split(self.take(f"{name}.in_proj_weight", 3 * size, size), 3)
        biases = np.split(self.take(f"{name}.in_proj_bias", 3 * size), 3)
        parts = {
            part: {"weight": weight, "bias": bias}
            for part, weight, bias in zip(("query", "key", "value"), weights, biases, strict=True)
        }
        return {**parts, "output": self.dense(f"{name}.out_proj", size, size)}


def network(weights: Weights, config: act.Config, n_axes: int, token_norms: Mapping[str, Affine]) -> Params:
    """Everything but the scales of pixels and actions, which are not weights.

    token_norms: LeRobot's key of each token, in order. What its normalisation adds goes to the token's bias.
    """
    size = config.model_size
    params: dict[str, Any] = {
        "latent": weights.dense("encoder_latent_input_proj", config.latent_size, size),
        "tokens": [_token(weights, key, norm, size) for key, norm in token_norms.items()],
        "token_position": weights.take("encoder_1d_feature_pos_embed.weight", 1 + len(token_norms), size),
        "encoder": [_encoder_layer(weights, i, config) for i in range(config.encoder_layers)],
        "query_position": weights.take("decoder_pos_embed.weight", config.horizon, size),
        "decoder": [_decoder_layer(weights, i, config) for i in range(config.decoder_layers)],
        "norm": weights.norm("decoder.norm", size),
        "action": weights.dense("action_head", size, n_axes),
    }
    if config.backbone is not None:
        channels = config.backbone.channels
        params["backbone"] = _backbone(weights, channels // 8)
        name = "encoder_img_feat_input_proj"
        projection = weights.take(f"{name}.weight", size, channels, 1, 1)[:, :, 0, 0]
        params["camera_projection"] = {"weight": projection, "bias": weights.take(f"{name}.bias", size)}
        params["camera_position"] = act.camera_positions(config)
    return params


def _token(weights: Weights, key: str, norm: Affine, size: int) -> Params:
    dense = weights.dense(LINEARS.get(key, ENVIRONMENT_LINEAR), len(norm.mean), size)
    shift = dense["weight"].sum(axis=1, dtype=np.float64) * norm.shift
    return {"weight": dense["weight"], "bias": (dense["bias"] + shift).astype(np.float32)}


def _encoder_layer(weights: Weights, index: int, config: act.Config) -> Params:
    name, size, wide = f"encoder.layers.{index}", config.model_size, config.feedforward
    return {
        "attention": weights.attention(f"{name}.self_attn", size),
        "norm1": weights.norm(f"{name}.norm1", size),
        "feedforward1": weights.dense(f"{name}.linear1", size, wide),
        "feedforward2": weights.dense(f"{name}.linear2", wide, size),
        "norm2": weights.norm(f"{name}.norm2", size),
    }


def _decoder_layer(weights: Weights, index: int, config: act.Config) -> Params:
    name, size, wide = f"decoder.layers.{index}", config.model_size, config.feedforward
    return {
        "self_attention": weights.attention(f"{name}.self_attn", size),
        "norm1": weights.norm(f"{name}.norm1", size),
        "cross_attention": weights.attention(f"{name}.multihead_attn", size),
        "norm2": weights.norm(f"{name}.norm2", size),
        "feedforward1": weights.dense(f"{name}.linear1", size, wide),
        "feedforward2": weights.dense(f"{name}.linear2", wide, size),
        "norm3": weights.norm(f"{name}.norm3", size),
    }


def _backbone(weights: Weights, width: int) -> Params:
    """torchvision's names are ours."""

    def batch_norm(name: str, channels: int) -> Params:
        names: Sequence[str] = ("weight", "bias", "running_mean", "running_var")
        return {part: weights.take(f"backbone.{name}.{part}", channels) for part in names}

    def convolution(name: str, n_in: int, n_out: int, kernel: int) -> Params:
        return {"weight": weights.take(f"backbone.{name}.weight", n_out, n_in, kernel, kernel)}

    def block(name: str, n_in: int, n_out: int) -> Params:
        params: dict[str, Any] = {
            "conv1": convolution(f"{name}.conv1", n_in, n_out, 3),
            "bn1": batch_norm(f"{name}.bn1", n_out),
            "conv2": convolution(f"{name}.conv2", n_out, n_out, 3),
            "bn2": batch_norm(f"{name}.bn2", n_out),
        }
        if n_in != n_out:
            shortcut = convolution(f"{name}.downsample.0", n_in, n_out, 1)
            params["downsample"] = [shortcut, batch_norm(f"{name}.downsample.1", n_out)]
        return params

    params: dict[str, Any] = {"conv1": convolution("conv1", 3, width, 7), "bn1": batch_norm("bn1", width)}
    n_in = width
    for stage in range(4):
        n_out = width << stage
        name = f"layer{stage + 1}"
        params[name] = [block(f"{name}.0", n_in, n_out), block(f"{name}.1", n_out, n_out)]
        n_in = n_out
    return params
