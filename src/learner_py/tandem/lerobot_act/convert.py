"""A folder of LeRobot's ACT -> a policy file.

    SOURCE/config.json              settings of the policy
    SOURCE/model.safetensors        weights; before LeRobot's processors also the statistics, as buffers
    SOURCE/policy_preprocessor.json, policy_postprocessor.json    steps around the policy, each with its own
                                    safetensors file: the statistics of newer checkpoints

A setting that our network can't follow exactly is refused with a sentence. What only training needs is left behind:
the VAE's encoder, the dropout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from tandem import run_folder
from tandem.learner.golden import golden_examples
from tandem.learner.networks import act
from tandem.learner.networks.base import Params
from tandem.lerobot_act.read import read_json
from tandem.lerobot_act.statistics import Normalizer, read_normalizers
from tandem.lerobot_act.weights import Weights, network
from tandem.policy_file import (
    Array,
    PolicyFileError,
    PolicyHeader,
    WrittenFile,
    read_safetensors,
    rounded,
    write_policy,
)

# Setting, what we follow (LeRobot's default), what to do about another value.
SETTINGS: list[tuple[str, Any, str]] = [
    ("type", "act", "Only ACT policies can be converted."),
    ("n_obs_steps", 1, "Train with one observation step."),
    ("pre_norm", False, "Train with pre_norm: false."),
    (
        "feedforward_activation",
        "relu",
        "Train with relu; our gelu is the tanh form, PyTorch's is another function.",
    ),
    ("use_peft", False, "Merge the adapter into the weights first."),
]
CAMERA_SETTINGS: list[tuple[str, Any, str]] = [
    ("vision_backbone", "resnet18", "Train with resnet18."),
    ("replace_final_stride_with_dilation", False, "Train without dilation."),
]

STATE = "observation.state"


def convert(source: Path, destination: Path, bfloat16: bool = False) -> WrittenFile:
    """Writes the policy file. Raises PolicyFileError, a sentence, when the checkpoint can't be followed."""
    settings = read_json(source / "config.json")
    _check(source, settings, SETTINGS)
    features = Features.read(source / "config.json", settings)
    if features.cameras:
        _check(source, settings, CAMERA_SETTINGS)
    config = _config(source, settings, features)
    tensors, _ = read_safetensors(source / "model.safetensors")
    weights = Weights(source / "model.safetensors", tensors)
    normalizers = read_normalizers(source, settings, tensors)

    token_norms = {
        key: normalizers.inputs.of_input(key, "STATE" if key == STATE else "ENV", size)
        for key, size in features.tokens.items()
    }
    params = network(weights, config, features.n_axes, token_norms)
    params["output"] = _float32(normalizers.action.of_action(features.n_axes))
    if features.cameras:
        params["image"] = _float32(_pixels(normalizers.inputs, list(features.cameras)))
    weights.refuse_unused()

    mean = np.concatenate([norm.mean for norm in token_norms.values()]).astype(np.float32)
    scale = np.concatenate([norm.scale for norm in token_norms.values()]).astype(np.float32)
    params = rounded(params) if bfloat16 else params
    golden = golden_examples("act", config, params, features.n_axes, mean, scale, np.random.default_rng(0))
    header = PolicyHeader(
        architecture="act",
        config=config.model_dump(mode="json"),
        observation=[f"{_short(key)}.{i}" for key, size in features.tokens.items() for i in range(size)],
        action=[f"action.{i}" for i in range(features.n_axes)],
        task="lerobot",
        method="act",
        execution=_execution(settings),
        discount=1.0,
        version=0,
        env_steps=0,
        updates=0,
        episodes_trained_through=-1,
        git_revision=run_folder.git_revision(),
    )
    return write_policy(destination, header, params, mean, scale, golden, bfloat16)


# ---- settings


def _check(source: Path, settings: Mapping[str, Any], rules: list[tuple[str, Any, str]]) -> None:
    for name, wanted, remedy in rules:
        value = settings.get(name, wanted)
        if value != wanted:
            raise PolicyFileError(
                f"{source / 'config.json'}: {name} is {value!r}; it must be {wanted!r}. {remedy}"
            )


@dataclass(frozen=True)
class Features:
    """Inputs and outputs in the order in which the network takes them."""

    tokens: dict[str, int]  # LeRobot's key -> numbers
    cameras: dict[str, tuple[int, int]]  # LeRobot's key -> height, width
    n_axes: int

    @staticmethod
    def read(path: Path, settings: Mapping[str, Any]) -> Features:
        inputs, outputs = settings.get("input_features"), settings.get("output_features")
        if not isinstance(inputs, dict) or not isinstance(outputs, dict) or "action" not in outputs:
            raise PolicyFileError(
                f"{path}: input_features or output_features with an action are missing; LeRobot's newer versions "
                "write them. Save the checkpoint once more with such a version."
            )
        try:
            shapes = {key: (feature["type"], tuple(feature["shape"])) for key, feature in inputs.items()}
            (n_axes,) = outputs["action"]["shape"]
            # the state comes first, whatever the order in the file; other states are not looked at
            states = [key for key, (kind, _) in shapes.items() if kind == "STATE" and key == STATE]
            environment = [key for key, (kind, _) in shapes.items() if kind == "ENV"][:1]
            tokens = {key: shapes[key][1][0] for key in [*states, *environment]}
            cameras = {key: shape for key, (kind, shape) in shapes.items() if kind == "VISUAL"}
        except (TypeError, KeyError, ValueError, IndexError) as error:
            raise PolicyFileError(f"{path}: its features are not LeRobot's ({error!r}).") from None
        for key, shape in cameras.items():
            if len(shape) != 3 or shape[0] != 3:
                raise PolicyFileError(
                    f"{path}: {key} has shape {list(shape)}; it must be [3, height, width]."
                )
        if not tokens:
            raise PolicyFileError(
                f"{path}: it has neither observation.state nor an environment state; our ACT needs one of them. "
                "Train with the robot's state among the inputs."
            )
        sizes = {key: (height, width) for key, (_, height, width) in cameras.items()}
        return Features(tokens, sizes, n_axes)


def _config(source: Path, settings: Mapping[str, Any], features: Features) -> act.Config:
    sizes = {
        "horizon": settings.get("chunk_size", 100),
        "model_size": settings.get("dim_model", 512),
        "heads": settings.get("n_heads", 8),
        "feedforward": settings.get("dim_feedforward", 3200),
        "encoder_layers": settings.get("n_encoder_layers", 4),
        "decoder_layers": settings.get("n_decoder_layers", 1),
        "latent_size": settings.get("latent_dim", 32),
    }
    cameras = [
        {"name": _short(key), "height": height, "width": width}
        for key, (height, width) in features.cameras.items()
    ]
    try:
        return act.Config.model_validate(
            sizes
            | {
                "activation": "relu",
                "sample_latent": False,
                "tokens": [{"name": _short(key), "size": size} for key, size in features.tokens.items()],
                "cameras": cameras,
                "backbone": {"kind": "resnet18", "width": 64} if cameras else None,
                "output": "linear",
            }
        )
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"]) or "its sizes"
        raise PolicyFileError(f"{source / 'config.json'}: {name}: {first['msg']}.") from None


def _execution(settings: Mapping[str, Any]) -> dict[str, Any]:
    """How LeRobot executes a chunk: n steps of it, or the weighted mean of all chunks about a step."""
    decay = settings.get("temporal_ensemble_coeff")
    execution = {
        "latency_ticks": 0,
        "noise_chunk": 0.0,
        "noise_step": 0.0,
        "noise_clip": 0.0,
        "noise_speed": 0.0,
    }
    if decay is not None:
        return {"mode": "temporal_ensembling", "execute": 1, "ensemble_decay": decay} | execution
    steps = settings.get("n_action_steps", 100)
    return {"mode": "open_loop", "execute": steps, "ensemble_decay": 0.0} | execution


def _pixels(normalizer: Normalizer, cameras: list[str]) -> dict[str, Array]:
    """mean and scale (3) of pixels in [0, 1]; our cameras share them."""
    norms = [normalizer.of_input(key, "VISUAL", 3) for key in cameras]
    pixels = [{"mean": norm.mean - norm.shift / norm.scale, "scale": norm.scale} for norm in norms]
    for key, other in zip(cameras, pixels, strict=True):
        if not all(np.allclose(other[name], pixels[0][name], rtol=1e-6, atol=1e-7) for name in other):
            raise PolicyFileError(
                f"{normalizer.place}: the images of {cameras[0]} and {key} are normalised differently; our cameras "
                "share one mean and one scale. Train with ImageNet's statistics for all (use_imagenet_stats)."
            )
    return pixels[0]


def _float32(arrays: dict[str, Array]) -> Params:
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def _short(key: str) -> str:
    """observation.images.top -> top, observation.state -> state"""
    return key.removeprefix("observation.").removeprefix("images.")
