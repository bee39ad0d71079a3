"""Q on the episode page is what the policy file's critics say, and interventions are where the log has them."""

from __future__ import annotations

from pathlib import Path

import heads
import numpy as np
import support

from tandem.learner.windows import executed_chunks
from tandem.log.episode_page import interventions
from tandem.log.values import values
from tandem.policy_file import PolicyHeader, read_safetensors, write_policy

COLUMNS = [0, 6]  # x, gripper


def policy_file(path: Path) -> Path:
    """A best of N for observations of 3 numbers and chunks of 3 steps by 2 axes, with 3 critics."""
    config = heads.best_of_n([("mlp", heads.mlp(), 1)], edit=False)
    _, params = heads.network("best_of_n", config, 3, len(COLUMNS))
    header = PolicyHeader(
        config, ["a", "b", "c"], ["x", "gripper"], "peg", "tandem", {}, 0.95, 7, 0, 0, -1, "abc", "best_of_n"
    )
    mean, scale = np.array([0.5, 1.0, 0.0], np.float32), np.array([2.0, 0.5, 1.0], np.float32)
    golden = {"observation": np.zeros((1, 3)), "chunk": np.zeros((1, 3, 2)), "noise": np.zeros((1, 1))}
    write_policy(path, header, params, mean, scale, golden)
    return path


def q_in_numpy(file: Path, observation: np.ndarray, chunk: np.ndarray) -> np.ndarray:
    """The critics' mean, written anew."""
    tensors, _ = read_safetensors(file)
    x = (observation - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    inputs = np.concatenate([x, chunk.reshape(len(x), -1)], axis=1)
    scores = []
    for member in range(3):
        of = {
            k.removeprefix(f"critic.{member}.layers."): v
            for k, v in tensors.items()
            if f"critic.{member}." in k
        }
        y = inputs @ of["0.weight"].T + of["0.bias"]
        y = (y - y.mean(1, keepdims=True)) / np.sqrt(y.var(1, keepdims=True) + 1e-6)
        y = np.maximum(y * of["0.norm_scale"] + of["0.norm_offset"], 0)
        scores.append((y @ of["1.weight"].T + of["1.bias"])[:, 0])
    return np.mean(scores, axis=0)


def test_values_are_what_the_critics_in_the_file_say(tmp_path: Path) -> None:
    file = policy_file(tmp_path / "policy.safetensors")
    episode = support.episode(2, n_steps=5)
    asked = np.random.default_rng(0).uniform(-1, 1, (3, 3, 7)).astype(np.float32)
    found = values(file, episode, np.array([0, 3, 9]), asked)  # step 9 is not of this episode
    assert found is not None and found.version == 7
    executed, _ = executed_chunks(episode, COLUMNS, 3)
    np.testing.assert_allclose(found.executed, q_in_numpy(file, episode.observation, executed), rtol=1e-4)
    expected = q_in_numpy(file, episode.observation[[0, 3]], asked[:2][:, :, COLUMNS])
    np.testing.assert_allclose(found.asked[[0, 3]], expected, rtol=1e-4)
    assert np.isnan(found.asked[[1, 2, 4]]).all()


def test_stretches_of_interventions_are_told_by_their_edges() -> None:
    episode = support.episode(0, n_steps=7, intervention=[1, 1, 0, 0, 1, 0, 1])
    assert interventions(episode) == [(0, 2), (4, 5), (6, 7)]
    assert interventions(support.episode(0, n_steps=3)) == []


def test_executed_chunks_end_in_hold() -> None:
    chunk, valid = executed_chunks(support.episode(0, n_steps=3), COLUMNS, 2)
    np.testing.assert_allclose(chunk[-1], [[0.02, 0.02], [0.0, 0.02]], atol=1e-6)
    assert valid.tolist() == [[True, True], [True, True], [True, False]]
