"""Random policies of the benchmark, from the learner's networks: files that all contenders read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tandem.learner import networks
from tandem.learner.golden import golden_examples
from tandem.policy_bench.policies import BenchPolicy
from tandem.policy_file import PolicyHeader, named_arrays, write_policy

SEED = 4
ACTION_GAIN = 3.0  # a fresh network's actions are near zero
BATCH_NORM_GAIN = 0.5  # as trained ones do, keeps eight blocks from adding up; float32 would lose two digits


def write(path: Path, policy: BenchPolicy) -> None:
    """A policy file with random weights and golden examples; the same bytes every time on a machine."""
    generator = np.random.default_rng(SEED)
    head = networks.HEADS[policy.architecture]
    config = networks.read_config(policy.architecture, policy.config)
    axes = len(policy.action)
    params = lively(generator, head.init(generator, config, policy.observation, axes))
    mean = generator.normal(0.0, 1.0, policy.observation).astype(np.float32)
    scale = generator.uniform(0.5, 2.0, policy.observation).astype(np.float32)
    golden = golden_examples(policy.architecture, config, params, axes, mean, scale, generator)
    header = PolicyHeader(
        architecture=policy.architecture,
        config=policy.config,
        observation=[f"observation_{i}" for i in range(policy.observation)],
        action=policy.action,
        task="benchmark",
        method="random",
        execution={},
        discount=0.99,
        version=0,
        env_steps=0,
        updates=0,
        episodes_trained_through=-1,
        git_revision="",
    )
    write_policy(path, header, params, mean, scale, golden)


def lively(generator: np.random.Generator, params: Any) -> Any:
    """The same network with no array of zeros or ones, and with actions of some size: a lost bias must show."""
    varied = {}
    for name, array in named_arrays(params).items():
        array = np.asarray(array)
        if array.ndim == 1:
            array = generator.uniform(0.8, 1.25, array.shape) * array + generator.uniform(
                0.0, 0.1, array.shape
            )
            if name.endswith(".weight"):
                array = array * BATCH_NORM_GAIN
        elif name == "action.weight":
            array = ACTION_GAIN * array
        varied[name] = array.astype(np.float32)
    return tree(varied)


def tree(arrays: Mapping[str, Any]) -> Any:
    """The inverse of `named_arrays`: {"layers.0.bias": b} -> {"layers": [{"bias": b}]}."""
    nested: dict[str, Any] = {}
    for name, array in arrays.items():
        *path, last = name.split(".")
        at = nested
        for part in path:
            at = at.setdefault(part, {})
        at[last] = array
    return _lists(nested)


def _lists(value: Any) -> Any:
    """Dicts whose keys are 0, 1, ... as lists."""
    if not isinstance(value, dict):
        return value
    parts = {key: _lists(part) for key, part in value.items()}
    if set(parts) == {str(i) for i in range(len(parts))}:
        return [parts[str(i)] for i in range(len(parts))]
    return parts
