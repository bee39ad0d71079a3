"""A checkpoint as LeRobot saves an ACT policy, made of random numbers, and what such a policy computes.

Written from LeRobot's formulas, in its own layout (tokens, batch, channels; images channels first) and in double.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from safetensors.numpy import save_file

Arrays = dict[str, np.ndarray]
STATE, ENVIRONMENT = "observation.state", "observation.environment_state"
IMAGENET = {"mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]}


class Checkpoint:
    """settings (config.json), tensors (model.), statistics of every key, and the processors' JSON; change, then save.

    processors: as newer versions save the statistics; otherwise as buffers among the weights.
    """

    def __init__(
        self,
        state: int = 6,
        environment: int = 0,
        cameras: dict[str, tuple[int, int]] | None = None,
        n_axes: int = 4,
        processors: bool = True,
        modes: dict[str, str] | None = None,
        seed: int = 0,
    ) -> None:
        self.processors = processors
        self.modes = modes or {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"}
        features: dict[str, Any] = {}
        for key, (height, width) in (cameras or {}).items():  # LeRobot's order says nothing about the tokens'
            features[key] = {"type": "VISUAL", "shape": [3, height, width]}
        if environment:
            features[ENVIRONMENT] = {"type": "ENV", "shape": [environment]}
        features[STATE] = {"type": "STATE", "shape": [state]}
        self.settings: dict[str, Any] = {
            "type": "act", "n_obs_steps": 1, "input_features": features,
            "output_features": {"action": {"type": "ACTION", "shape": [n_axes]}},
            "device": "cuda", "use_amp": False, "chunk_size": 5, "n_action_steps": 5,
            "normalization_mapping": self.modes, "vision_backbone": "resnet18",
            "pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1",
            "replace_final_stride_with_dilation": False, "pre_norm": False, "dim_model": 24, "n_heads": 3,
            "dim_feedforward": 40, "feedforward_activation": "relu", "n_encoder_layers": 2, "n_decoder_layers": 2,
            "use_vae": True, "latent_dim": 7, "n_vae_encoder_layers": 1, "temporal_ensemble_coeff": None,
            "dropout": 0.1, "kl_weight": 10.0, "optimizer_lr": 1e-5,
        }  # fmt: skip
        self._generator = np.random.default_rng(seed)
        self.tensors: Arrays = {}
        self._fill()
        sizes = {
            key: feature["shape"] for key, feature in (features | self.settings["output_features"]).items()
        }
        self.statistics = {key: self._statistics(shape) for key, shape in sizes.items()}
        self.steps: list[dict[str, Any]] = []  # further ones before the normaliser

    # ---- random contents

    def _fill(self) -> None:
        s, features = self.settings, self.settings["input_features"]
        size, wide, n_axes = s["dim_model"], s["dim_feedforward"], s["output_features"]["action"]["shape"][0]
        sees = any(feature["type"] == "VISUAL" for feature in features.values())
        self._linear("encoder_robot_state_input_proj", features[STATE]["shape"][0], size)
        if ENVIRONMENT in features:
            self._linear("encoder_env_state_input_proj", features[ENVIRONMENT]["shape"][0], size)
        self._linear("encoder_latent_input_proj", s["latent_dim"], size)
        self._add("encoder_1d_feature_pos_embed.weight", 2 + (ENVIRONMENT in features), size)
        self._add("decoder_pos_embed.weight", s["chunk_size"], size)
        self._linear("action_head", size, n_axes)
        self._layers("encoder", s["n_encoder_layers"], size, wide)
        self._layers("decoder", s["n_decoder_layers"], size, wide)
        self._norm("decoder.norm", size)
        # what only training needs
        self._layers("vae_encoder", s["n_vae_encoder_layers"], size, wide)
        self._add("vae_encoder_cls_embed.weight", 1, size)
        self._add("vae_encoder_pos_enc", 1, s["chunk_size"] + 2, size)
        self._linear("vae_encoder_latent_output_proj", size, 2 * s["latent_dim"])
        if sees:
            self._add("encoder_img_feat_input_proj.weight", size, 512, 1, 1)
            self._add("encoder_img_feat_input_proj.bias", size)
            self._backbone()

    def _add(self, name: str, *shape: int, mean: float = 0.0, deviation: float | None = None) -> None:
        if deviation is None:
            deviation = np.prod(shape[1:]) ** -0.5 if len(shape) > 1 else 0.2
        self.tensors[f"model.{name}"] = self._generator.normal(mean, deviation, shape).astype(np.float32)

    def _linear(self, name: str, n_in: int, n_out: int) -> None:
        self._add(f"{name}.weight", n_out, n_in)
        self._add(f"{name}.bias", n_out)

    def _norm(self, name: str, size: int) -> None:
        self._add(f"{name}.weight", size, mean=1.0)
        self._add(f"{name}.bias", size)

    def _layers(self, stack: str, n: int, size: int, wide: int) -> None:
        attentions = ["self_attn", "multihead_attn"] if stack == "decoder" else ["self_attn"]
        for name in (f"{stack}.layers.{i}" for i in range(n)):
            for attention in attentions:
                self._add(f"{name}.{attention}.in_proj_weight", 3 * size, size)
                self._add(f"{name}.{attention}.in_proj_bias", 3 * size)
                self._linear(f"{name}.{attention}.out_proj", size, size)
            self._linear(f"{name}.linear1", size, wide)
            self._linear(f"{name}.linear2", wide, size)
            for i in range(len(attentions) + 1):
                self._norm(f"{name}.norm{i + 1}", size)

    def _backbone(self) -> None:
        def convolution(name: str, n_in: int, n_out: int, kernel: int) -> None:
            deviation = (2 / (n_in * kernel**2)) ** 0.5
            self._add(f"backbone.{name}.weight", n_out, n_in, kernel, kernel, deviation=deviation)

        def norm(name: str, n: int) -> None:
            self._norm(f"backbone.{name}", n)
            self._add(f"backbone.{name}.running_mean", n)
            self._add(f"backbone.{name}.running_var", n)
            variance = self.tensors[f"model.backbone.{name}.running_var"]
            variance[:] = 1.0 + abs(variance)

        convolution("conv1", 3, 64, 7)
        norm("bn1", 64)
        n_in = 64
        for stage, n_out in enumerate((64, 128, 256, 512)):
            for block in (0, 1):
                name = f"layer{stage + 1}.{block}"
                convolution(f"{name}.conv1", n_in, n_out, 3)
                norm(f"{name}.bn1", n_out)
                convolution(f"{name}.conv2", n_out, n_out, 3)
                norm(f"{name}.bn2", n_out)
                if n_in != n_out:
                    convolution(f"{name}.downsample.0", n_in, n_out, 1)
                    norm(f"{name}.downsample.1", n_out)
                n_in = n_out

    def _statistics(self, shape: list[int]) -> Arrays:
        if len(shape) == 3:
            return {name: np.array(values, np.float32).reshape(3, 1, 1) for name, values in IMAGENET.items()}
        n = shape[0]
        low, high = np.sort(self._generator.normal(0, 0.8, (2, n)), axis=0)
        numbers = {
            "mean": self._generator.normal(0, 0.5, n), "std": self._generator.uniform(0.3, 1.2, n),
            "min": low - 0.3, "max": high + 0.3, "q01": low - 0.2, "q99": high + 0.2,
        }  # fmt: skip
        return {name: array.astype(np.float32) for name, array in numbers.items()}

    # ---- files

    def save(self, folder: Path) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "config.json").write_text(json.dumps(self.settings, indent=4))
        tensors = dict(self.tensors)
        if self.processors:
            self._save_processor(folder, "policy_preprocessor", "normalizer_processor", 3)
            self._save_processor(folder, "policy_postprocessor", "unnormalizer_processor", 0)
        else:
            for key, numbers in self.statistics.items():
                sides = (
                    ["normalize_targets", "unnormalize_outputs"] if key == "action" else ["normalize_inputs"]
                )
                for side in sides:
                    for name, array in numbers.items():
                        tensors[f"{side}.buffer_{key.replace('.', '_')}.{name}"] = array
        save_file(tensors, folder / "model.safetensors")
        return folder

    def _save_processor(self, folder: Path, name: str, step: str, index: int) -> None:
        inputs, outputs = self.settings["input_features"], self.settings["output_features"]
        state_file = f"{name}_step_{index}_{step}.safetensors"
        normalizer = {
            "registry_name": step,
            "config": {
                "eps": 1e-8,
                "features": inputs | outputs if index else outputs,
                "norm_map": self.modes,
            },
            "state_file": state_file,
        }
        device = {"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": None}}
        if index:
            rename = {"registry_name": "rename_observations_processor", "config": {"rename_map": {}}}
            batch = {"registry_name": "to_batch_processor", "config": {}}
            steps = [rename, batch, device, *self.steps, normalizer]
        else:
            steps = [normalizer, device]
        (folder / f"{name}.json").write_text(json.dumps({"name": name, "steps": steps}, indent=2))
        flat = {
            f"{key}.{n}": array for key, numbers in self.statistics.items() for n, array in numbers.items()
        }
        save_file(flat, folder / state_file)

    # ---- the policy

    def normalise(self, key: str, value: np.ndarray) -> np.ndarray:
        kind = self.settings["input_features"][key]["type"]
        mode, numbers = self.modes.get(kind, "IDENTITY"), self._double(key)
        if mode == "IDENTITY":
            return value
        if mode == "MEAN_STD":
            return (value - numbers["mean"]) / (numbers["std"] + 1e-8)
        low, high = self._bounds(mode, numbers)
        if self.processors:
            width = np.where(high == low, 1e-8, high - low)
            return 2 * (value - low) / width - 1
        return (value - low) / (high - low + 1e-8) * 2 - 1

    def unnormalise(self, action: np.ndarray) -> np.ndarray:
        mode, numbers = self.modes.get("ACTION", "IDENTITY"), self._double("action")
        if mode == "IDENTITY":
            return action
        if mode == "MEAN_STD":
            return action * numbers["std"] + numbers["mean"]
        low, high = self._bounds(mode, numbers)
        return (action + 1) / 2 * (high - low) + low

    def _double(self, key: str) -> Arrays:
        return {name: array.astype(np.float64) for name, array in self.statistics[key].items()}

    def _bounds(self, mode: str, numbers: Arrays) -> tuple[np.ndarray, np.ndarray]:
        low, high = {"MIN_MAX": ("min", "max"), "QUANTILES": ("q01", "q99")}[mode]
        return numbers[low], numbers[high]

    def forward(self, batch: Arrays) -> np.ndarray:
        """Raw inputs by LeRobot's keys, images (B, 3, H, W) in [0, 1] -> actions (B, chunk, axes)."""
        s, features = self.settings, self.settings["input_features"]
        x = {key: self.normalise(key, batch[key].astype(np.float64)) for key in features}
        b = len(x[STATE])
        tokens = [self._dense("encoder_latent_input_proj", np.zeros((b, s["latent_dim"])))]
        tokens.append(self._dense("encoder_robot_state_input_proj", x[STATE]))
        if ENVIRONMENT in features:
            tokens.append(self._dense("encoder_env_state_input_proj", x[ENVIRONMENT]))
        positions = list(self._get("encoder_1d_feature_pos_embed.weight")[:, None])
        for key, feature in features.items():
            if feature["type"] != "VISUAL":
                continue
            seen = self._resnet18(x[key])  # (B, 512, h, w)
            table = self._positions(*seen.shape[2:])  # (d, h, w)
            weight = self._get("encoder_img_feat_input_proj.weight")
            bias = self._get("encoder_img_feat_input_proj.bias")
            seen = _convolve(seen, weight, 1, 0) + bias[:, None, None]
            tokens += list(seen.reshape(b, len(table), -1).transpose(2, 0, 1))
            positions += list(table.reshape(len(table), -1).T[:, None])
        memory, position = np.stack(tokens), np.stack(positions)  # (T, B, d), (T, 1, d)
        for i in range(s["n_encoder_layers"]):
            name = f"encoder.layers.{i}"
            placed = memory + position
            memory = self._norm_of(
                name, 1, memory + self._attend(f"{name}.self_attn", placed, placed, memory)
            )
            memory = self._norm_of(name, 2, memory + self._feedforward(name, memory))
        y = np.zeros((s["chunk_size"], b, s["dim_model"]))
        query = self._get("decoder_pos_embed.weight")[:, None]
        for i in range(s["n_decoder_layers"]):
            name = f"decoder.layers.{i}"
            y = self._norm_of(name, 1, y + self._attend(f"{name}.self_attn", y + query, y + query, y))
            seen = self._attend(f"{name}.multihead_attn", y + query, memory + position, memory)
            y = self._norm_of(name, 2, y + seen)
            y = self._norm_of(name, 3, y + self._feedforward(name, y))
        y = self._layer_norm("decoder.norm", y)
        return self.unnormalise(self._dense("action_head", y.transpose(1, 0, 2)))

    def _get(self, name: str) -> np.ndarray:
        return self.tensors[f"model.{name}"].astype(np.float64)

    def _dense(self, name: str, x: np.ndarray) -> np.ndarray:
        return x @ self._get(f"{name}.weight").T + self._get(f"{name}.bias")

    def _layer_norm(self, name: str, x: np.ndarray) -> np.ndarray:
        y = (x - x.mean(-1, keepdims=True)) / np.sqrt(x.var(-1, keepdims=True) + 1e-5)
        return y * self._get(f"{name}.weight") + self._get(f"{name}.bias")

    def _norm_of(self, layer: str, index: int, x: np.ndarray) -> np.ndarray:
        return self._layer_norm(f"{layer}.norm{index}", x)

    def _feedforward(self, name: str, x: np.ndarray) -> np.ndarray:
        return self._dense(f"{name}.linear2", np.maximum(self._dense(f"{name}.linear1", x), 0))

    def _attend(self, name: str, query: np.ndarray, key: np.ndarray, value: np.ndarray) -> np.ndarray:
        """torch's multi-head attention on (tokens, batch, d)."""
        size, heads = self.settings["dim_model"], self.settings["n_heads"]
        weight, bias = self._get(f"{name}.in_proj_weight"), self._get(f"{name}.in_proj_bias")
        parts = []
        for i, x in enumerate((query, key, value)):
            rows = slice(i * size, (i + 1) * size)
            parts.append((x @ weight[rows].T + bias[rows]).reshape(*x.shape[:2], heads, size // heads))
        q, k, v = parts
        scores = np.einsum("qbhc,tbhc->bhqt", q, k) / math.sqrt(size // heads)
        scores = np.exp(scores - scores.max(-1, keepdims=True))
        scores /= scores.sum(-1, keepdims=True)
        mixed = np.einsum("bhqt,tbhc->qbhc", scores, v)
        return self._dense(f"{name}.out_proj", mixed.reshape(*mixed.shape[:2], size))

    def _resnet18(self, x: np.ndarray) -> np.ndarray:
        """torchvision's, up to layer4: (B, 3, H, W) -> (B, 512, h, w)."""

        def convolve(name: str, x: np.ndarray, stride: int, margin: int) -> np.ndarray:
            return _convolve(x, self._get(f"backbone.{name}.weight"), stride, margin)

        def norm(name: str, x: np.ndarray) -> np.ndarray:
            names = ("weight", "bias", "running_mean", "running_var")
            weight, bias, mean, variance = (self._get(f"backbone.{name}.{n}")[:, None, None] for n in names)
            return (x - mean) / np.sqrt(variance + 1e-5) * weight + bias

        x = np.maximum(norm("bn1", convolve("conv1", x, 2, 3)), 0)
        padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
        x = sliding_window_view(padded, (3, 3), (2, 3))[:, :, ::2, ::2].max((-1, -2))
        for stage in range(4):
            for block in (0, 1):
                name, stride = f"layer{stage + 1}.{block}", 2 if stage and not block else 1
                y = np.maximum(norm(f"{name}.bn1", convolve(f"{name}.conv1", x, stride, 1)), 0)
                y = norm(f"{name}.bn2", convolve(f"{name}.conv2", y, 1, 1))
                if stride == 2:
                    x = norm(f"{name}.downsample.1", convolve(f"{name}.downsample.0", x, 2, 0))
                x = np.maximum(x + y, 0)
        return x

    def _positions(self, height: int, width: int) -> np.ndarray:
        """LeRobot's 2-D sine embedding (d, h, w)."""
        half = self.settings["dim_model"] // 2
        rows = np.cumsum(np.ones((height, width)), axis=0)
        columns = np.cumsum(np.ones((height, width)), axis=1)
        rows, columns = rows / (rows[-1:] + 1e-6) * 2 * np.pi, columns / (columns[:, -1:] + 1e-6) * 2 * np.pi
        frequency = 10000 ** (2 * (np.arange(half) // 2) / half)
        tables = []
        for axis in (rows, columns):
            angle = axis[..., None] / frequency
            both = np.stack([np.sin(angle[..., 0::2]), np.cos(angle[..., 1::2])], axis=-1)
            tables.append(both.reshape(height, width, half))
        return np.concatenate(tables, axis=2).transpose(2, 0, 1)


def _convolve(x: np.ndarray, weight: np.ndarray, stride: int, margin: int) -> np.ndarray:
    """(B, C, H, W), (out, C, k, k) -> (B, out, H', W')"""
    padded = np.pad(x, ((0, 0), (0, 0), (margin, margin), (margin, margin)))
    windows = sliding_window_view(padded, weight.shape[2:], (2, 3))[:, :, ::stride, ::stride]
    return np.tensordot(windows, weight, axes=([1, 4, 5], [1, 2, 3])).transpose(0, 3, 1, 2)
