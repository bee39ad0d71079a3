"""The runtime is a library of its own: installed, found by CMake, used by 30 lines."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np

from tandem.policy_file import PolicyHeader, write_policy

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(os.environ.get("TANDEM_BIN", ROOT / "build" / "bin")).parent
HEADER = PolicyHeader(
    config={"hidden": [], "activation": "relu", "layer_norm": False, "horizon": 2, "output": "tanh"},
    observation=["force", "height"],
    action=["x"],
    task="example",
    method="bc",
    execution={},
    discount=0.98,
    version=1,
    env_steps=0,
    updates=0,
    episodes_trained_through=-1,
    git_revision="test",
)


def sh(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_example_finds_the_installed_library_and_runs_a_policy(tmp_path: Path) -> None:
    sh("cmake", "--install", BUILD, "--component", "policy_runtime", "--prefix", tmp_path / "prefix")
    example = ROOT / "src" / "policy_runtime" / "example"
    sh("cmake", "-S", example, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'prefix'}")
    sh("cmake", "--build", tmp_path / "build")

    observation = np.random.default_rng(1).normal(size=(8, 2)).astype(np.float32)
    weight = np.array([[0.5, 0.0], [0.0, -0.25]], np.float32)
    write_policy(
        tmp_path / "policy.safetensors",
        HEADER,
        {"layers": [{"weight": weight, "bias": np.zeros(2, np.float32)}]},
        mean=np.zeros(2, np.float32),
        scale=np.ones(2, np.float32),
        golden={"observation": observation, "chunk": np.tanh(observation @ weight.T)[:, :, None]},
    )
    lines = sh(tmp_path / "build" / "run_policy", tmp_path / "policy.safetensors", "1", "2").split()
    np.testing.assert_allclose(np.array(lines, float), np.tanh([0.5, -0.5]), atol=1e-6)
