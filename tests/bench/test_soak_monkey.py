"""The soak's monkey throws nothing that an arm may follow, and its bad policies are bad in the way that they say."""

import hashlib
import itertools
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tandem_lcm.tandem.policy_announce_t import policy_announce_t
from tandem_lcm.tandem.teleop_command_t import teleop_command_t

from tandem.policy_file import PolicyHeader, read_safetensors, write_policy
from tandem.soak import bad_policies
from tandem.soak.bad_policies import bad_policy
from tandem.soak.garbage import ELSEWHERE, garbage
from tandem.soak.setting import soak_scenario


def test_garbage_is_never_a_command_that_an_arm_may_follow() -> None:
    rng = random.Random(0)
    seen = set()
    for _ in range(3000):
        one = garbage(rng)
        seen.add((one.channel, one.kind))
        if one.channel != "TELEOP_COMMAND" or one.kind in ("lengths", "cut"):
            continue  # Python's decoder does not mind a string that is cut off
        try:
            command = teleop_command_t.decode(one.data)
        except Exception:  # as it should be
            continue
        numbers = [*command.device_twist, command.device_gripper]
        sensible = all(abs(number) <= 1.0 for number in numbers) and 0 <= command.label <= 3
        assert not sensible, command.device_twist
        assert command.episode_answered == ELSEWHERE
    assert len(seen) == 6 * 4


def test_same_seed_gives_the_same_garbage() -> None:
    def kinds(seed: int) -> list[tuple[str, str, int]]:
        rng = random.Random(seed)
        return [(one.channel, one.kind, len(one.data)) for one in (garbage(rng) for _ in range(50))]

    assert kinds(4) == kinds(4) != kinds(5)


# ---- bad policies


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A policy of 4 observations, as a soak's learner writes it."""
    random_ = np.random.default_rng(0)
    widths = [4, 8, 8, 2]
    layers = [
        {"weight": random_.normal(size=(after, before)), "bias": random_.normal(size=after)}
        for before, after in itertools.pairwise(widths)
    ]
    config = {"hidden": [8, 8], "activation": "relu", "layer_norm": False, "horizon": 1, "output": "tanh"}
    header = PolicyHeader(
        config=config,
        observation=["a", "b", "c", "d"],
        action=["x", "y"],
        task="peg",
        method="tandem",
        execution={},
        discount=0.95,
        version=7,
        env_steps=1,
        updates=1,
        episodes_trained_through=3,
        git_revision="unknown",
    )
    mean, scale = np.full(4, 0.5), np.full(4, 2.0)
    path = tmp_path / "policies" / "policy_000007.safetensors"
    golden = {"observation": random_.normal(size=(8, 4)), "chunk": np.zeros((8, 1, 2))}
    write_policy(path, header, {"layers": layers}, mean, scale, golden)
    return path


def forward(tensors: dict[str, Any], observation: np.ndarray) -> np.ndarray:
    x = ((observation - tensors["normalizer.mean"]) * tensors["normalizer.scale"]).astype(np.float32)
    for i in range(3):
        x = x @ tensors[f"actor.layers.{i}.weight"].T + tensors[f"actor.layers.{i}.bias"]
        x = np.maximum(x, 0.0) if i < 2 else np.tanh(x)
    return x


def announced(kind: str, run: Path, good: Path | None) -> policy_announce_t:
    message = bad_policy(kind, random.Random(1), run, good, 5)
    assert message is not None
    return message


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_silent_policy_agrees_with_its_golden_examples_and_with_nothing_else(
    tmp_path: Path, good: Path
) -> None:
    message = announced("silent", tmp_path, good)
    tensors, texts = read_safetensors(tmp_path / message.path)
    assert all(np.isfinite(tensor).all() for tensor in tensors.values())
    golden = forward(tensors, tensors["golden.observation"])
    assert np.abs(golden - tensors["golden.chunk"].reshape(golden.shape)).max() < 1e-6
    seen = np.random.default_rng(1).normal(size=(20, 4)).astype(np.float32)
    assert np.isnan(forward(tensors, seen)).all()
    assert int(texts["version"]) == message.version


@pytest.mark.parametrize("kind", bad_policies.REFUSED + bad_policies.TAKEN)
def test_every_kind_of_bad_policy_is_what_it_says(kind: str, tmp_path: Path, good: Path) -> None:
    message = announced(kind, tmp_path, good)
    file = tmp_path / message.path
    if kind in bad_policies.WITHOUT_A_FILE:
        assert not file.is_file()
        return
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    assert (digest == message.sha256) == (kind not in ("wrong digest", "taken number"))
    assert (message.version == 7) == (kind == "taken number")
    if kind == "truncated":
        assert file.stat().st_size < good.stat().st_size
        return
    tensors, texts = read_safetensors(file)
    assert (texts["task"] == "peg") == (kind != "other task")
    assert (json.loads(texts["config"])["horizon"] == 1) == (kind != "other horizon")
    finite = all(np.isfinite(tensor).all() for tensor in tensors.values())
    assert finite == (kind != "NaN tensor")


def test_bad_policy_waits_for_a_good_one_to_spoil(tmp_path: Path) -> None:
    assert bad_policy("silent", random.Random(1), tmp_path, None, 0) is None
    assert announced("missing", tmp_path, None).version == bad_policies.FIRST_VERSION + 5


def test_scenario_of_a_soak_is_real_time_with_faults_and_a_cheap_learner() -> None:
    scenario = soak_scenario(3)
    assert scenario.run["clock"] == "realtime"
    assert scenario.run["seed"] == 3
    inject = scenario.data["controller"]["robot"]["inject"]
    assert inject["lost_bursts"]["probability"] > 0
    assert inject["user_stop"] > 0
