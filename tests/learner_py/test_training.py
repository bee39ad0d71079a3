"""Training: the same run gives the same bits, interrupted or not, and it learns what is known to be right."""

from __future__ import annotations

import jax
import numpy as np
import pytest
import support
from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.learner import checkpoint
from tandem.learner.checkpoint import CheckpointError
from tandem.learner.critic import mean_score
from tandem.learner.trainer import Trainer
from tandem.policy_file import read_safetensors


def stream():
    """Two demonstrations, then training episodes, one of them discarded."""
    yield support.demonstration(0, n_steps=6)
    yield support.demonstration(1, n_steps=5)
    outcomes = [episode_end_t.SUCCESS, episode_end_t.DISCARD, episode_end_t.TIMEOUT, episode_end_t.SUCCESS]
    for number, outcome in enumerate(outcomes, start=2):
        intervention = [0, 0, 1, 1, 0] if number == 2 else []
        yield support.episode(
            number, outcome=outcome, intervention=intervention, env_steps_total=5 * (number - 1)
        )


def learn(trainer, last=99, after_block=lambda report: True):
    for episode in stream():
        if episode.number > last:
            return trainer
        trainer.ingest(episode)
        if episode.number > trainer.position.episodes_trained_through and not trainer.train(
            episode, after_block
        ):
            return trainer
    return trainer


# the simplest; samples and the critic's choice among them; a slow critic, a reference, two sets of rows
METHODS = ["mcbc", "tandem", "ibrl"]
_uninterrupted = {}


@pytest.fixture(params=METHODS)
def method(request):
    return request.param


@pytest.fixture
def uninterrupted(method):
    if method not in _uninterrupted:
        _uninterrupted[method] = learn(Trainer(support.scenario(method=method)))
    return _uninterrupted[method]


def test_same_seed_gives_the_same_bits(method, uninterrupted):
    again = learn(Trainer(support.scenario(method=method)))
    assert support.tree_bytes(again.state) == support.tree_bytes(uninterrupted.state)


def test_another_seed_gives_other_parameters(method, uninterrupted):
    data = support.scenario_data(method)
    data["run"]["seed"] = 4
    other = learn(Trainer(type(support.scenario()).model_validate(data)))
    assert support.tree_bytes(other.state.actors) != support.tree_bytes(uninterrupted.state.actors)


@pytest.mark.parametrize("last", [0, 1, 2, 3, 4])
def test_resumed_run_equals_the_uninterrupted_one(tmp_path, method, uninterrupted, last):
    learn(Trainer(support.scenario(method=method)), last).save(tmp_path / "c")
    resumed = Trainer(support.scenario(method=method))
    resumed.restore(tmp_path / "c")
    learn(resumed)
    assert support.tree_bytes(resumed.state) == support.tree_bytes(uninterrupted.state)
    assert resumed.position == uninterrupted.position


def test_run_stopped_within_the_warm_start_resumes_at_that_update(tmp_path, method, uninterrupted):
    stopped = learn(Trainer(support.scenario(method=method)), after_block=lambda report: False)
    assert 0 < stopped.position.updates_into_next < 70
    stopped.save(tmp_path / "c")
    resumed = Trainer(support.scenario(method=method))
    resumed.restore(tmp_path / "c")
    learn(resumed)
    assert support.tree_bytes(resumed.state) == support.tree_bytes(uninterrupted.state)


def test_result_does_not_depend_on_how_updates_are_grouped_into_calls(monkeypatch, method, uninterrupted):
    monkeypatch.setattr("tandem.learner.trainer.BLOCK", 7)
    again = learn(Trainer(support.scenario(method=method)))
    assert support.tree_bytes(again.state) == support.tree_bytes(uninterrupted.state)


def test_deployed_policy_is_the_moving_average_of_the_actor(monkeypatch, tmp_path):
    monkeypatch.setattr("tandem.learner.trainer.BLOCK", 1)
    trainer = Trainer(support.scenario())

    def weight(networks):
        return np.asarray(networks["actor"]["layers"][0]["weight"])

    average = weight(trainer.state.average)

    def follow(report):
        nonlocal average
        decay = min(0.998, trainer.updates / (9 + trainer.updates))  # (1 + n) / (10 + n) after n updates
        average = decay * average + (1 - decay) * weight(trainer.state.actors)
        return True

    learn(trainer, last=1, after_block=follow)
    np.testing.assert_allclose(weight(trainer.state.average), average, atol=1e-6)
    assert np.abs(average - weight(trainer.state.actors)).max() > 1e-5
    trainer.write_policy(tmp_path / "policy")
    written = read_safetensors(tmp_path / "policy")[0]["actor.layers.0.weight"]
    np.testing.assert_array_equal(written, weight(trainer.state.average))


def test_update_counts_follow_step_counts_and_discards_cost_nothing(uninterrupted):
    assert uninterrupted.updates == 70 + 2 * (5 + 5 + 5)
    assert uninterrupted.buffer.size == 6 + 5 + 5 + 5 + 5
    # warm start, then one policy for each training episode, discarded ones too
    assert uninterrupted.position.version == 5


def test_fractional_update_ratio_loses_no_update():
    trainer = learn(Trainer(support.scenario(updates_per_env_step=0.3)))
    assert trainer.updates == 70 + int(0.3 * 15)


def test_figures_of_a_report_are_means_or_nothing(method):
    """A number that stands for nothing would be drawn as one."""
    reports = []
    learn(Trainer(support.scenario(method=method)), after_block=lambda report: reports.append(report) or True)
    warm, trained = reports[0], reports[-1]
    assert warm.n_updates == 64 and np.isfinite([warm.critic_loss, warm.actor_loss]).all()
    assert np.isnan([warm.win_share, warm.win_share_human, warm.win_share_autonomous]).all()
    shares = [trained.win_share, trained.win_share_human, trained.win_share_autonomous]
    assert (
        np.isnan(shares).all()
        if method == "tandem"
        else ((np.array(shares) >= 0) & (np.array(shares) <= 1)).all()
    )


def test_updates_without_the_actors_turn_report_no_loss_of_the_actor(monkeypatch):
    monkeypatch.setattr("tandem.learner.trainer.BLOCK", 1)
    trainer, reports = Trainer(support.scenario(method="hil_serl")), []
    learn(trainer, last=2, after_block=lambda report: reports.append(report) or True)
    trained = reports[70:]
    assert [np.isnan(report.actor_loss) for report in trained] == [True, False] * 5
    assert np.isfinite([report.critic_loss for report in trained]).all()


def test_nothing_is_learnt_before_there_are_rows_to_learn_from():
    """Without demonstrations a method that imitates the human waits for the first intervention."""
    trainer = Trainer(support.scenario(method="hg_dagger", demonstrations=0))
    alone, helped = support.episode(0), support.episode(1, intervention=[0, 0, 1, 0, 0])
    for episode, due in ((alone, 0), (helped, 10)):
        trainer.ingest(episode)
        assert trainer.updates_due(episode) == due
        trainer.train(episode, lambda report: True)
    assert trainer.updates == 10 and trainer.position.version == 2
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(trainer.state))


def test_checkpoint_of_another_scenario_is_refused(tmp_path, method, uninterrupted):
    uninterrupted.save(tmp_path / "c")
    with pytest.raises(CheckpointError, match="another scenario"):
        Trainer(support.scenario(method=method, replay={"batch": 17})).restore(tmp_path / "c")


def test_checkpoint_holds_every_leaf(tmp_path, method, uninterrupted):
    uninterrupted.save(tmp_path / "c")
    fresh = Trainer(support.scenario(method=method))
    state, normalizer, position = checkpoint.load(tmp_path / "c", fresh.state, fresh.scenario.fingerprint())
    assert support.tree_bytes(state) == support.tree_bytes(uninterrupted.state)
    np.testing.assert_array_equal(normalizer.scale, uninterrupted.normalizer.scale)
    assert position == uninterrupted.position


def test_training_episode_before_the_demonstrations_is_refused():
    with pytest.raises(ValueError, match="only 0 of 2 demonstrations"):
        Trainer(support.scenario()).ingest(support.episode(0))


# ---- a line to walk: observation = (p, p / 2, 0.1), action x moves the place p by 0.2 x, success at p > 1


def walk(rng, action_of, kind, number, noise=0.0):
    """One episode of at most 12 steps under x = action_of(p) + noise."""
    place, observation, executed = -1.0, [[-1.0, -0.5, 0.1]], []
    while len(executed) < 12 and place <= 1.0:
        x = float(np.clip(action_of(place) + noise * rng.normal(), -1, 1))
        executed.append([x, 0, 0, 0, 0, 0, 0])
        place += 0.2 * x
        observation.append([place, 0.5 * place, 0.1])
    outcome = episode_end_t.SUCCESS if place > 1.0 else episode_end_t.TIMEOUT
    return kind(number, observation=observation, executed=executed, outcome=outcome)


def walker(method, demonstrations, warm_start_updates):
    learner = {
        "warm_start_updates": warm_start_updates, "updates_per_env_step": 6, "learning_rate": 1e-3, "ema": 0.98,
        "head": {"kind": "mlp", "mlp": {"hidden": [32]}}, "replay": {"batch": 64},
        "critic": {"hidden": [32, 32], "members": 3, "cut_return_at_intervention": True},
    }  # fmt: skip
    return support.scenario(method=method, horizon=1, demonstrations=demonstrations, **learner)


def test_critic_learns_the_analytic_value():
    """Demonstrations at constant x = 0.9 reach the end in 12 steps: Q = 0.9 ^ (steps to go - 1)."""
    rng = np.random.default_rng(0)
    trainer = Trainer(walker("mcbc", demonstrations=2, warm_start_updates=2000))
    episodes = [walk(rng, lambda p: 0.9, support.demonstration, number) for number in range(2)]
    for episode in episodes:
        trainer.ingest(episode)
    trainer.train(episodes[-1], lambda report: True)
    episode = episodes[0]
    x = trainer.normalizer.apply(episode.observation)
    value = mean_score(trainer.state.critics["critic"], x, episode.executed_action[:, None, [0, 5, 6]])
    truth = 0.9 ** np.arange(episode.n_steps - 1, -1, -1)
    assert np.abs(np.asarray(value) - truth).max() < 0.05


def final_speed(method):
    """Mean action of the policy after slow demonstrations and 40 noisy episodes under its own control."""
    rng = np.random.default_rng(1)
    trainer = Trainer(walker(method, demonstrations=4, warm_start_updates=500))

    def act(place):
        return float(trainer.act(np.array([[place, 0.5 * place, 0.1]], np.float32))[0, 0, 0])

    for number in range(44):
        if number < 4:
            episode = walk(rng, lambda p: 0.87, support.demonstration, number, noise=0.02)
            assert episode.end.outcome == episode_end_t.SUCCESS
        else:
            episode = walk(rng, act, support.episode, number, noise=0.15)
        trainer.ingest(episode)
        trainer.train(episode, lambda report: True)
    return np.mean([act(place) for place in np.linspace(-1, 0.8, 10)])


def test_max_q_grows_faster_than_its_demonstrations_and_cloning_does_not():
    max_q, cloned = final_speed("mcbc"), final_speed("bc")
    assert abs(cloned - 0.87) < 0.04
    assert max_q > cloned + 0.04
