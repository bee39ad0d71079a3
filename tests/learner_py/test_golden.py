"""Golden examples: rounding can't choose another winner than they say, and there are enough whatever was learnt."""

from __future__ import annotations

import heads
import numpy as np
import pytest
import support

from tandem.learner.golden import CLEAR, EXAMPLES, RANGE, SAME, golden_examples
from tandem.learner.networks import best_of_n
from tandem.learner.trainer import Trainer
from tandem.policy_file import read_safetensors

ONES, ZEROS = np.ones(7, np.float32), np.zeros(7, np.float32)


candidates = heads.jitted(best_of_n.candidates)


def examples(typed, params, observation=None):
    return golden_examples("best_of_n", typed, params, 2, ZEROS, ONES, np.random.default_rng(0), observation)


def in_double(typed, params, golden):
    """Candidates (N, n, h A), and their scores (N, n) as numbers of twice the precision give them."""
    x, noise = golden["observation"], golden["noise"]
    proposed = np.asarray(candidates(params, typed, x, noise, {}))
    flat = proposed.reshape(*proposed.shape[:2], -1).astype(np.float64)
    x = np.broadcast_to(x[:, None], (*flat.shape[:2], x.shape[1]))
    total = 0.0
    for member in params["critic"]:
        y = np.concatenate([x, flat], axis=2)
        for layer in member["layers"][:-1]:
            y = y @ layer["weight"].T.astype(np.float64) + layer["bias"]
            y = (y - y.mean(-1, keepdims=True)) / np.sqrt(y.var(-1, keepdims=True) + 1e-6)
            y = np.maximum(y * layer["norm_scale"] + layer["norm_offset"], 0.0)
        last = member["layers"][-1]
        total = total + y @ last["weight"][0].astype(np.float64) + last["bias"][0]
    return flat, total / len(params["critic"])


def check(typed, params, golden):
    """The winner is that of double precision, and stays it when every score is off by what rounding may do."""
    flat, score = in_double(typed, params, golden)
    chunk = golden["chunk"].reshape(len(flat), 1, -1)
    is_other = np.abs(flat - chunk).max(axis=2) > 1.01 * SAME
    assert not is_other.all(axis=1).any()
    rival = np.where(is_other, score, -np.inf).max(axis=1)
    assert (score.max(axis=1) - rival > 1e-6 * np.abs(score).max(axis=1)).all()


def flow_of(spread, samples=8):
    """A best of N whose flow gives nearly the same chunk whatever the noise: 0.3 and `spread` times the noise."""
    config = heads.flow(hidden=[], layer_norm=False, steps=1, time_features=2)
    typed, params = heads.network("best_of_n", heads.best_of_n([("flow", config, samples)], edit=False), 7, 2)
    last = params["actor"][0]["layers"][-1]
    last["weight"][:], last["bias"][:] = 0.0, 0.3
    last["weight"][:, 7:13] = (spread - 1.0) * np.eye(6)
    return typed, params


def test_a_best_of_n_has_clear_winners_at_the_observations_asked_for():
    config = heads.best_of_n([("gaussian", heads.gaussian(), 40)], edit=False)
    typed, params = heads.network("best_of_n", config, 7, 2)
    observation = np.random.default_rng(0).normal(size=(30, 7)).astype(np.float32)
    golden = examples(typed, params, observation)
    np.testing.assert_array_equal(golden["observation"], observation)
    check(typed, params, golden)
    _, score = in_double(typed, params, golden)
    first, second = np.sort(score)[:, -1], np.sort(score)[:, -2]
    assert (first - second > CLEAR).all()  # this critic adds up numbers of about 1
    chunk = heads.jitted(best_of_n.chunk)(params, typed, observation, golden["noise"], {})
    np.testing.assert_allclose(chunk, golden["chunk"], atol=2e-6)


@pytest.mark.parametrize("spread", [1e-2, 1e-3, 1e-4, 1e-5, 1e-7, 0.0])
def test_collapsed_flow_has_enough_examples_and_they_are_clear(spread):
    typed, params = flow_of(spread)
    golden = examples(typed, params)
    assert len(golden["chunk"]) >= EXAMPLES and np.abs(golden["observation"]).max() <= RANGE
    check(typed, params, golden)


@pytest.mark.parametrize("scale", [1e-3, 1e-6, 1e-9, 0.0])
@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_flat_critic_still_gives_enough_examples_that_are_clear(scale, offset):
    config = heads.best_of_n([("gaussian", heads.gaussian(), 3)], edit=False)
    typed, params = heads.network("best_of_n", config, 7, 2)
    for member in params["critic"]:
        member["layers"][-1]["weight"] *= np.float32(scale)
        member["layers"][-1]["bias"][:] = offset
    golden = examples(typed, params)
    assert len(golden["chunk"]) >= EXAMPLES
    check(typed, params, golden)


def test_lead_is_measured_by_what_the_critic_adds_up_not_by_a_score_near_zero():
    """Scores of 1e-5 made of terms of 1: a relative lead in them is rounding."""
    typed, params = flow_of(1e-5)
    for member in params["critic"]:
        last = member["layers"][-1]
        last["weight"][:] = np.where(np.arange(11) % 2, 1.0, -1.0)
    check(typed, params, examples(typed, params))


def test_flat_critic_with_edits_gives_a_file_all_the_same():
    typed, params = heads.network("best_of_n", heads.best_of_n([("gaussian", heads.gaussian(), 3)]), 7, 2)
    for member in params["critic"]:
        member["layers"][-1]["weight"][:] = 0.0
    golden = examples(typed, params)
    assert len(golden["chunk"]) == EXAMPLES
    # all scores are the same number, and the first of equals wins wherever it is computed
    first = np.asarray(candidates(params, typed, golden["observation"], golden["noise"], {}))[:, 0]
    np.testing.assert_allclose(golden["chunk"], first, atol=2e-6)


def test_policy_that_equals_its_reference_has_golden_examples(tmp_path):
    """IBRL when the warm start ends: both candidates are the same, and no noise can tell them apart."""
    trainer = Trainer(support.scenario(method="ibrl"))
    for number in range(2):
        episode = support.demonstration(number)
        trainer.ingest(episode)
        trainer.train(episode, lambda report: True)
    trainer.write_policy(tmp_path / "policy")
    tensors, _ = read_safetensors(tmp_path / "policy")
    np.testing.assert_array_equal(tensors["actor.0.layers.0.weight"], tensors["actor.1.layers.0.weight"])
    assert len(tensors["golden.chunk"]) == 16


def test_one_candidate_is_always_clear():
    config = heads.best_of_n([("mlp", heads.mlp(), 1)], edit=False)
    assert len(examples(*heads.network("best_of_n", config, 7, 2))["chunk"]) == EXAMPLES
