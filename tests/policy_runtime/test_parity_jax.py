"""The C++ runtime computes what JAX computes: random networks, both sides, at most 1e-5 apart."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

TOLERANCE = 1e-5  # action units
BIN = Path(os.environ.get("TANDEM_BIN", Path(__file__).resolve().parents[2] / "build" / "bin"))
AXES = ["x", "y", "z", "rx", "ry", "rz", "gripper"]
ACTIVATIONS = {"relu": jax.nn.relu, "tanh": jnp.tanh, "gelu": jax.nn.gelu}

Tensors = dict[str, np.ndarray]

# observation, hidden, axes, horizon, activation, layer norm
NETWORKS = [
    (1, [], 1, 1, "relu", False),
    (26, [256, 256], 4, 1, "relu", False),
    (26, [256, 256], 4, 1, "relu", True),
    (13, [1, 33], 3, 2, "tanh", False),
    (31, [17], 5, 3, "gelu", False),
    (40, [256, 256, 256], 7, 8, "gelu", True),
    (19, [127, 65, 7], 2, 7, "tanh", True),
    (64, [63, 100], 6, 4, "relu", True),
    (3, [300, 5], 7, 5, "gelu", True),
]


def random_network(seed: int, o: int, hidden: list[int], out: int, layer_norm: bool) -> Tensors:
    """Non-trivial in every tensor: an untrained or zero network would agree by chance."""
    rng = np.random.default_rng(seed)
    tensors: Tensors = {}
    sizes = [o, *hidden, out]
    for i, (n_in, n_out) in enumerate(itertools.pairwise(sizes)):
        tensors[f"actor.layers.{i}.weight"] = rng.normal(0.0, 1.0 / np.sqrt(n_in), (n_out, n_in))
        tensors[f"actor.layers.{i}.bias"] = rng.normal(0.0, 0.3, n_out)
        if layer_norm and i < len(hidden):
            tensors[f"actor.layers.{i}.norm_scale"] = rng.normal(1.0, 0.2, n_out)
            tensors[f"actor.layers.{i}.norm_offset"] = rng.normal(0.0, 0.2, n_out)
    tensors["normalizer.mean"] = rng.normal(0.0, 1.0, o)
    tensors["normalizer.scale"] = rng.uniform(0.3, 3.0, o)
    return {name: value.astype(np.float32) for name, value in tensors.items()}


def forward(tensors: Tensors, obs: jax.Array, activation: str, h: int) -> jax.Array:
    """obs (N, O), raw -> chunk (N, h, A)."""
    x = (obs - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    last = sum(name.endswith(".weight") for name in tensors) - 1
    for i in range(last + 1):
        prefix = f"actor.layers.{i}"
        x = x @ tensors[f"{prefix}.weight"].T + tensors[f"{prefix}.bias"]
        if f"{prefix}.norm_scale" in tensors:
            mean = x.mean(-1, keepdims=True)
            variance = ((x - mean) ** 2).mean(-1, keepdims=True)
            x = (x - mean) / jnp.sqrt(variance + 1e-6)
            x = x * tensors[f"{prefix}.norm_scale"] + tensors[f"{prefix}.norm_offset"]
        x = jnp.tanh(x) if i == last else ACTIVATIONS[activation](x)
    return x.reshape(len(obs), h, -1)


def write_policy(path: Path, tensors: Tensors, config: dict[str, Any], o: int, axes: list[str]) -> None:
    metadata = {
        "format": "tandem-policy-1",
        "architecture": "mlp",
        "config": json.dumps(config),
        "observation": json.dumps([f"observation_{i}" for i in range(o)]),
        "action": json.dumps(axes),
        "task": "peg",
        "method": "tandem",
        "execution": json.dumps({"mode": "receding", "execute": 1}),
        "discount": "0.98",
        "version": "1",
        "env_steps": "0",
        "updates": "0",
        "episodes_trained_through": "0",
        "git_revision": "test",
    }
    save_file(tensors, path, metadata=metadata)


def run(*arguments: str | Path, kernel: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BIN / "tandem_policy", *arguments],
        env=os.environ | {"TANDEM_KERNEL": kernel},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("kernel", ["simd", "scalar"])
@pytest.mark.parametrize("network", NETWORKS, ids=str)
def test_chunks_agree_with_jax(tmp_path: Path, network: tuple[Any, ...], kernel: str) -> None:
    o, hidden, n_axes, h, activation, layer_norm = network
    axes = AXES[:n_axes]
    tensors = random_network(hash((o, h, n_axes)) % 2**32, o, hidden, h * n_axes, layer_norm)
    rng = np.random.default_rng(7)
    golden = rng.normal(0.0, 1.5, (8, o)).astype(np.float32)
    fresh = rng.normal(0.0, 1.5, (64, o)).astype(np.float32)
    file = {
        **tensors,
        "golden.observation": golden,
        "golden.chunk": np.array(forward(tensors, jnp.asarray(golden), activation, h)),
    }
    config = {
        "hidden": hidden,
        "activation": activation,
        "layer_norm": layer_norm,
        "horizon": h,
        "output": "tanh",
    }
    policy = tmp_path / "policy.safetensors"
    write_policy(policy, file, config, o, axes)

    save_file({"observation": fresh}, tmp_path / "in.safetensors")
    paths: list[str | Path] = [
        "--input",
        tmp_path / "in.safetensors",
        "--output",
        tmp_path / "out.safetensors",
    ]
    result = run("run", policy, *paths, kernel=kernel)
    assert result.returncode == 0, result.stderr
    ours = load_file(tmp_path / "out.safetensors")["chunk"]

    theirs = np.array(forward(tensors, jnp.asarray(fresh), activation, h))
    assert ours.shape == theirs.shape == (64, h, n_axes)
    assert np.abs(theirs).max() > 0.1, "the network is too tame to test anything"
    np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=TOLERANCE)

    info = json.loads(run("info", policy, "--json", kernel=kernel).stdout)
    assert info["golden_error"] <= TOLERANCE
    assert info["action"] == axes and info["horizon"] == h


def test_a_wrong_golden_example_is_refused_with_a_sentence(tmp_path: Path) -> None:
    tensors = random_network(1, 5, [8], 2, False)
    golden = np.ones((8, 5), np.float32)
    chunk = np.array(forward(tensors, jnp.asarray(golden), "relu", 1))
    file = {**tensors, "golden.observation": golden, "golden.chunk": chunk + np.float32(1e-3)}
    config = {"hidden": [8], "activation": "relu", "layer_norm": False, "horizon": 1, "output": "tanh"}
    policy = tmp_path / "policy.safetensors"
    write_policy(policy, file, config, 5, ["x", "y"])
    result = run("info", policy)
    assert result.returncode == 2
    assert "golden examples differ by 0.001" in result.stderr
    assert str(policy) in result.stderr
