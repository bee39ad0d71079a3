"""The policies of `tandem bench policy`: their networks, and how much faster than the better of ONNX Runtime and
OpenVINO ours is to be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

AXES = ["x", "y", "z", "rx", "ry", "rz", "gripper"]
JOINTS = [f"joint_{i}" for i in range(14)]  # both arms of a LeRobot set-up


@dataclass(frozen=True)
class BenchPolicy:
    """Architecture and config as in a policy file, sizes, and the target."""

    name: str
    description: str
    architecture: str
    config: dict[str, Any]
    observation: int  # O
    action: list[str]
    target: float  # p50 of ours / p50 of the better of the two, to reach in float32

    @property
    def horizon(self) -> int:
        return int(self.config["horizon"])


def _mlp(hidden: list[int], horizon: int) -> dict[str, Any]:
    return {
        "hidden": hidden,
        "activation": "relu",
        "layer_norm": False,
        "horizon": horizon,
        "output": "tanh",
    }


def _flow(hidden: list[int], horizon: int, steps: int) -> dict[str, Any]:
    return {**_mlp(hidden, horizon), "field": "mlp", "steps": steps, "time_features": 16, "output": "clip"}


def _act(
    size: int, heads: int, feedforward: int, encoder_layers: int, horizon: int, state: int, image: int = 0
) -> dict[str, Any]:
    camera = {"name": "camera", "height": image, "width": image}
    return {
        "horizon": horizon,
        "model_size": size,
        "heads": heads,
        "feedforward": feedforward,
        "encoder_layers": encoder_layers,
        "decoder_layers": 1,
        "activation": "relu",
        "latent_size": 32,
        "sample_latent": False,
        "tokens": [{"name": "state", "size": state}],
        "cameras": [camera] if image else [],
        "backbone": {"kind": "resnet18", "width": 64} if image else None,
        "output": "tanh",
    }


POLICIES = [
    BenchPolicy("mlp_40_256x3_56", "MLP 40-256³-56", "mlp", _mlp([256] * 3, 8), 40, AXES, 0.5),
    BenchPolicy("mlp_40_512x4_112", "MLP 40-512⁴-112", "mlp", _mlp([512] * 4, 16), 40, AXES, 0.5),
    BenchPolicy(
        "act_d128",
        "ACT d128, 2+1 layers, ff 512, 16 steps, state",
        "act",
        _act(128, 4, 512, 2, 16, 40),
        40,
        AXES,
        0.7,
    ),
    BenchPolicy(
        "act_d256",
        "ACT d256, 4+1 layers, ff 1024, 16 steps, state",
        "act",
        _act(256, 4, 1024, 4, 16, 40),
        40,
        AXES,
        0.7,
    ),
    BenchPolicy(
        "act_d256_resnet18_96",
        "the same with ResNet-18 at 96 px",
        "act",
        _act(256, 4, 1024, 4, 16, 40, image=96),
        40,
        AXES,
        0.9,
    ),
    BenchPolicy(
        "lerobot_act",
        "LeRobot's ACT: d512, ff 3200, 4+1 layers, 100 steps, one 224 px camera",
        "act",
        {**_act(512, 8, 3200, 4, 100, 14, image=224), "output": "linear"},
        14,
        JOINTS,
        0.9,
    ),
    BenchPolicy(
        "flow_512",
        "flow, 10 steps of an MLP 512³, chunk 8 x 7",
        "flow",
        _flow([512] * 3, 8, 10),
        40,
        AXES,
        0.5,
    ),
    BenchPolicy(
        "best_of_8",
        "best of 8 flow samples, 8 steps of an MLP 128², 5 critics 128²",
        "best_of_n",
        {
            "horizon": 4,
            "heads": [{"architecture": "flow", "config": _flow([128] * 2, 4, 8), "samples": 8}],
            "edit": None,
            "critic": {
                "hidden": [128, 128],
                "activation": "relu",
                "layer_norm": True,
                "members": 5,
                "aggregate": "mean",
            },
        },
        26,
        AXES,
        0.5,
    ),
]
