"""What a method is made of: its data, its decision, its reference; and every method of config/methods as a whole."""

from __future__ import annotations

import heads
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import support
from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.learner.method import Method
from tandem.learner.networks import HEADS, best_of_n, read_config
from tandem.learner.trainer import Trainer
from tandem.policy_file import network, read_header, read_safetensors


def train(trainer, numbers, intervention=(0, 0, 1, 0, 0)):
    """Two demonstrations, 0 and 1, then training episodes that a human helps in."""
    for number in numbers:
        shown = number < 2
        episode = (
            support.demonstration(number) if shown else support.episode(number, intervention=intervention)
        )
        trainer.ingest(episode)
        trainer.train(episode, lambda report: True)
    return trainer


def rows(method, name):
    """Rows of a demonstration, of an episode that a human helped in, and of one that timed out."""
    shown = support.demonstration(0, n_steps=2)
    helped = support.episode(1, n_steps=4, intervention=[0, 1, 1, 0])
    failed = support.episode(2, n_steps=3, outcome=episode_end_t.TIMEOUT)
    return [method.rows(e, method.windows(e))[name].astype(int).tolist() for e in (shown, helped, failed)]


@pytest.mark.parametrize(
    ("data", "imitated"),
    [
        ("all", [[1, 1], [1, 1, 1, 1], [1, 1, 1]]),
        ("human", [[1, 1], [0, 1, 1, 0], [0, 0, 0]]),
        ("demonstrations", [[1, 1], [0, 0, 0, 0], [0, 0, 0]]),
        ("success", [[1, 1], [1, 1, 1, 1], [0, 0, 0]]),
    ],
)
def test_actor_imitates_the_rows_that_its_data_names(data, imitated):
    method = Method(support.scenario(improvement={"kind": "imitate", "data": data}))
    assert rows(method, "imitated") == imitated


def test_prior_rows_are_the_humans_and_online_rows_those_of_training():
    method = Method(support.scenario(method="hil_serl"))
    assert rows(method, "prior") == [[1, 1], [0, 1, 1, 0], [0, 0, 0]]
    assert rows(method, "online") == [[0, 0], [1, 1, 1, 1], [1, 1, 1]]


def test_buffer_keeps_the_sets_that_are_drawn_from_and_no_other():
    expected = {
        "mcbc": (["all"], False), "hg_dagger": (["imitated"], False), "tandem": (["all", "imitated"], True),
        "hil_serl": (["prior", "online"], False), "qc": (["all"], False),
    }  # fmt: skip
    for name, (sets, is_apart) in expected.items():
        method = Method(support.scenario(method=name))
        assert (method.row_sets, method.imitates_other_rows) == (sets, is_apart), name


def test_return_is_cut_at_interventions_where_the_method_says_so():
    helped = support.episode(0, n_steps=4, intervention=[0, 0, 1, 0])
    cut = {
        name: Method(support.scenario(method=name)).windows(helped).mc_return[0] == 0
        for name in ("tandem", "mcbc")
    }
    assert cut == {"tandem": True, "mcbc": False}


def test_best_of_n_decides_for_the_sample_that_the_critic_prefers():
    method = Method(support.scenario(method="tandem"))
    state = method.init(seed=0)
    n_chunk = method.config.horizon * 3
    likes_first_axis = support.linear_critics([0.0] * 3 + [1.0] + [0.0] * (n_chunk - 1))
    networks = state.average | {
        "critic": jax.tree.map(lambda a: jnp.tile(a, (2, 1, 1)[: a.ndim]), likes_first_axis)
    }
    x = np.zeros((5, 3), np.float32)
    noise = np.random.default_rng(0).normal(size=(5, method.noise_size)).astype(np.float32)
    decided = np.asarray(method.decide(networks, x, noise))
    config = method.deployed[1]
    samples = np.asarray(best_of_n.candidates(method.policy(networks), config, x, noise, {}))
    assert samples.shape[1] == 8 and np.ptp(samples[:, :, 0, 0], axis=1).min() > 0.1
    np.testing.assert_array_equal(decided[:, 0, 0], samples[:, :, 0, 0].max(axis=1))


def test_reference_is_the_actor_that_the_warm_start_left_and_no_later_one():
    trainer = train(Trainer(support.scenario(method="ibrl")), range(2))
    left = support.tree_bytes(trainer.state.average["actor"])
    assert support.tree_bytes(trainer.state.average["reference"]) == left
    train(trainer, range(2, 5))
    assert support.tree_bytes(trainer.state.average["reference"]) == left
    assert support.tree_bytes(trainer.state.average["actor"]) != left
    assert support.tree_bytes(trainer.method.policy(trainer.state.average)["actor"][1]) == left


@pytest.mark.parametrize("name", support.METHODS)
def test_every_method_trains_deploys_and_resumes(tmp_path, name):
    scenario = support.scenario(method=name, warm_start_updates=2, updates_per_env_step=0.4)
    trainer = train(Trainer(scenario), range(3))
    assert trainer.updates == 4
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(trainer.state))

    trainer.write_policy(tmp_path / "policy")
    header = read_header(tmp_path / "policy")
    tensors, _ = read_safetensors(tmp_path / "policy")
    assert header.method == name and header.updates == 4 and len(tensors["golden.chunk"]) >= 8
    config = read_config(header.architecture, header.config)
    params = network(tensors, header.architecture)
    x = (tensors["golden.observation"] - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    noise = tensors.get("golden.noise", np.zeros((len(x), 0), np.float32))
    chunk = heads.jitted(HEADS[header.architecture].chunk)(params, config, x, noise, {})
    np.testing.assert_allclose(chunk, tensors["golden.chunk"], atol=5e-6)

    trainer.save(tmp_path / "checkpoint")
    resumed = Trainer(scenario)
    resumed.restore(tmp_path / "checkpoint")
    for number in range(3):
        resumed.ingest(
            support.demonstration(number)
            if number < 2
            else support.episode(number, intervention=[0, 0, 1, 0, 0])
        )
    for each in (trainer, resumed):
        train(each, [3])
    assert support.tree_bytes(trainer.state) == support.tree_bytes(resumed.state)
