"""The built program tandem_policy, and policy files of random networks for it."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from tandem.policy_file import PolicyHeader

BIN = Path(os.environ.get("TANDEM_BIN", Path(__file__).resolve().parents[2] / "build" / "bin"))
Arrays = Mapping[str, np.ndarray]


def program(*arguments: str | Path, kernel: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BIN / "tandem_policy", *arguments],
        env=os.environ | {"TANDEM_KERNEL": kernel},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def run(policy: Path, inputs: Arrays, kernel: str = "") -> np.ndarray:
    """inputs: observation (N, O), noise (N, noise_size), image.CAMERA (N, H, W, 3) -> chunk (N, h, A)."""
    folder = policy.parent
    save_file(
        {name: np.ascontiguousarray(array) for name, array in inputs.items()}, folder / "in.safetensors"
    )
    paths = ["--input", folder / "in.safetensors", "--output", folder / "out.safetensors"]
    done = program("run", policy, *paths, kernel=kernel)
    assert done.returncode == 0, done.stderr
    return load_file(folder / "out.safetensors")["chunk"]


def info(policy: Path, kernel: str = "") -> dict[str, Any]:
    done = program("info", policy, "--json", "--runs", "1", kernel=kernel)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def header(architecture: str, config: dict[str, Any], n_observation: int, n_axes: int) -> PolicyHeader:
    return PolicyHeader(
        architecture=architecture,
        config=config,
        observation=[f"observation_{i}" for i in range(n_observation)],
        action=[f"joint_{i}" for i in range(n_axes)],
        task="peg",
        method="tandem",
        execution={"mode": "receding", "execute": 1},
        discount=0.98,
        version=1,
        env_steps=0,
        updates=0,
        episodes_trained_through=-1,
        git_revision="test",
    )
