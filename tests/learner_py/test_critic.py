"""What critics learn on a chain whose values are known.

States 0 .. 5, action 0.5 leads from each to the next and from 5 to success: Q = 0.9^(5 - s). Action -0.5 in state 3
fails. Another episode times out after state 2.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import support
from jax import lax
from tandem_lcm.tandem.episode_end_t import episode_end_t

from tandem.learner.critic import (
    bootstrap_value,
    expectile_loss,
    grasp_loss,
    mean_score,
    regression_loss,
)
from tandem.learner.improvement import LOSSES
from tandem.learner.method import Method
from tandem.learner.networks import ensemble_values, grasp

ON, OFF = 0.5, -0.5
TRUE = 0.9 ** np.arange(5, -1, -1)


def seen(state):
    return [state / 2.5 - 1.0, np.sin(2.0 * state), np.cos(2.0 * state)]


def played(number, actions, outcome=episode_end_t.SUCCESS):
    executed = [[x, 0, 0, 0, 0, 0, 0] for x in actions]
    observation = [seen(state) for state in range(len(actions) + 1)]
    return support.episode(number, observation=observation, executed=executed, outcome=outcome)


WHOLE = played(0, [ON] * 6)
CUT_OFF = played(1, [ON] * 3, episode_end_t.TIMEOUT)
FAILED = played(2, [ON] * 3 + [OFF], episode_end_t.FAILURE)


def method_of(horizon=1, steps=1, **critic):
    td = {"steps": steps, "target_decay": 0.9} | critic.pop("td", {})
    critic = {"hidden": [32], "td": td} | critic
    return Method(
        support.scenario(horizon=horizon, critic=critic, improvement={"kind": "imitate"}, learning_rate=5e-3)
    )


def rows_of(method, episodes):
    """All their windows as one minibatch."""
    windows = [method.windows(episode) for episode in episodes]
    arrays = {
        name: jnp.concatenate([jnp.asarray(one.columns()[name]) for one in windows])
        for name in windows[0].columns()
    }
    rows = jnp.arange(len(arrays["mc_return"]))
    return method.batch(arrays, rows, jnp.zeros(3), jnp.ones(3), jax.random.PRNGKey(0))


def learnt(method, batch, monkeypatch, updates=1500):
    """The state after updates of the critics alone; the policy always goes on, with the padding of the last step."""

    def going_on(_method, _networks, x, _noise):
        index = jnp.arange(method.config.horizon)
        is_real = index[None, :] < 6 - jnp.round((x[:, :1] + 1.0) * 2.5)
        return jnp.zeros((len(x), method.config.horizon, 3)).at[:, :, 0].set(jnp.where(is_real, ON, 0.0))

    monkeypatch.setattr(Method, "decide", going_on)
    optimizer = method.critic_optimizer

    def update(state, key):
        gradient, _ = jax.grad(method.critic_loss, has_aux=True)(state.critics, {}, state, batch, key)
        step, optimizer_state = optimizer.update(gradient, state.critic_optimizer, state.critics)
        critics = optax.apply_updates(state.critics, step)
        average = method.averages(state, {**state.actors, **critics}, jnp.bool_(False))
        return state._replace(
            critics=critics, average=average, critic_optimizer=optimizer_state, updates=state.updates + 1
        ), None

    run = support.quickly(lambda state, keys: lax.scan(update, state, keys)[0])
    return run(method.init(0), jax.random.split(jax.random.PRNGKey(0), updates))


def values(method, state, batch):
    return np.asarray(mean_score(state.critics["critic"], batch.x, batch.chunk))


@pytest.mark.parametrize(("horizon", "steps"), [(1, 1), (1, 4), (2, 4)])
def test_td_finds_the_values_of_the_chain_through_a_time_out(monkeypatch, horizon, steps):
    method = method_of(horizon, steps, kind="td")
    # what others did later than the next step stays in the sum of several rewards: no failure among them then
    episodes = [WHOLE, CUT_OFF] if steps > 1 else [WHOLE, CUT_OFF, FAILED]
    batch = rows_of(method, episodes)
    found = values(method, learnt(method, batch, monkeypatch), batch)
    np.testing.assert_allclose(found[:6], TRUE, atol=0.05)
    np.testing.assert_allclose(found[6:9], TRUE[:3], atol=0.05)  # as if the time-out had gone on
    assert steps > 1 or abs(found[-1]) < 0.05


def test_time_out_that_counts_as_an_end_takes_half_of_the_last_states_value(monkeypatch):
    method = method_of(kind="td", td={"timeout_is_terminal": True})
    batch = rows_of(method, [WHOLE, CUT_OFF])
    found = values(method, learnt(method, batch, monkeypatch), batch)
    expected = np.append(TRUE[2] / 2 * np.array([0.81, 0.9, 1.0]), TRUE[3:])
    np.testing.assert_allclose(found[:6], expected, atol=0.05)


def test_mc_is_the_mean_of_the_returns_that_were_earned(monkeypatch):
    method = method_of(kind="mc")
    batch = rows_of(method, [WHOLE, CUT_OFF, FAILED])
    found = values(method, learnt(method, batch, monkeypatch), batch)
    np.testing.assert_allclose(found[:6], np.append(TRUE[:3] / 3, TRUE[3:]), atol=0.05)
    assert abs(found[-1]) < 0.05


def test_iql_values_the_state_by_its_better_action_and_imitates_that(monkeypatch):
    """In state 3 going on leads to success and going back fails, each once."""
    method = Method(
        support.scenario(
            method="iql",
            critic={"hidden": [32], "expectile": 0.95, "td": {"target_decay": 0.9}},
            head={"kind": "mlp"},
            learning_rate=5e-3,
        )
    )
    batch = rows_of(method, [WHOLE, FAILED])
    state = learnt(method, batch, monkeypatch, updates=2500)
    value = np.asarray(method.state_value(state.critics["value"], batch.x))
    np.testing.assert_allclose(value[:6], TRUE, atol=0.08)
    q = mean_score(state.critics["critic"], batch.x, batch.chunk)

    def chosen(kind):
        loss = LOSSES[kind]
        actor = support.minimise(
            lambda trained, key: loss(method, trained, state.critics, batch, q, key)[0], state.actors, 500
        )["actor"]
        x = batch.x[3:4]
        return float(method.actor.sample(actor, x, jax.random.PRNGKey(0))[0, 0, 0])

    assert chosen("awr") > 0.4 and abs(chosen("imitate")) < 0.15


def test_critic_of_the_gripper_closes_the_hand_where_that_earns_and_pays_for_a_change_of_mind():
    """One step, told open before: in place 1 a closed hand succeeds, in place -1 an open one."""
    episodes = []
    for number, (place, gripper) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        observation = [[place, 0.0, 0.08], [place, 0.0, 0.08]]
        outcome = episode_end_t.SUCCESS if place == gripper else episode_end_t.FAILURE
        executed = [[0, 0, 0, 0, 0, 0, gripper]]
        facts = {"observation": observation, "executed": executed, "outcome": outcome}
        episodes.append(support.episode(number, **facts))
    learner = {"gripper": {"hidden": [16], "toggle_cost": 0.25}, "learning_rate": 5e-3}
    method = Method(support.scenario(method="hil_serl", **learner))
    batch = rows_of(method, episodes)
    assert batch.chunk.shape == (4, 1, 2) and method.actor.n_axes == 2  # the rest is the head's
    assert batch.toggled.tolist() == [True, False, True, False]

    start = method.init(0)
    trained = support.minimise(
        lambda critics, key: method.critic_loss(critics, {}, start, batch, key)[0], start.critics
    )
    worth = np.asarray(grasp.worth(trained["grasp"]["layers"], "relu", batch.x))
    np.testing.assert_allclose(worth[:, 0], [0.0, 0.75], atol=0.05)
    np.testing.assert_allclose(worth[:, 2], [1.0, -0.25], atol=0.05)
    networks = {**start.average, "grasp": trained["grasp"]}
    told = method.decide(networks, batch.x, np.zeros((4, method.noise_size), np.float32))
    assert told.shape == (4, 1, 3) and told[:, 0, 2].tolist() == [1, 1, -1, -1]


def test_next_choice_is_the_live_critics_and_its_worth_the_slow_ones():
    worth, reward, bootstrap = jnp.zeros((2, 2)), jnp.array([0.5, 0.0]), jnp.array([0.9, 0.0])
    live, slow = jnp.array([[0.0, 0.0], [1.0, 1.0]]), jnp.array([[7.0, 7.0], [2.0, 2.0]])
    loss = grasp_loss(worth, jnp.array([True, False]), reward, bootstrap, live, slow)
    assert float(loss) == pytest.approx((0.5 + 0.9 * 2.0) ** 2 / 2)  # the second ended, with nothing


# ---- parts


def test_ranking_uses_the_mean_of_the_ensemble():
    # one member prefers large actions mildly, the other small ones strongly
    critic = support.linear_critics([0.0, 1.0], [0.0, -3.0])
    x, low, high = jnp.zeros((1, 1)), jnp.full((1, 1, 1), -0.5), jnp.full((1, 1, 1), 0.5)
    assert mean_score(critic, x, low)[0] > mean_score(critic, x, high)[0]
    np.testing.assert_allclose(ensemble_values(critic, x, high), [[0.5], [-1.5]])


def test_ranking_has_no_gradient():
    critic = support.linear_critics([0.0, 1.0])
    gradient = jax.grad(lambda chunk: mean_score(critic, jnp.zeros((1, 1)), chunk).sum())
    assert not gradient(jnp.zeros((1, 1, 1))).any()


def test_members_learn_as_if_alone_and_see_the_padding():
    critic = support.linear_critics([0.0, 0.0, 1.0], [0.0, 0.0, 3.0])
    padded = jnp.array([[[0.5], [1.0]]])
    assert regression_loss(ensemble_values(critic, jnp.zeros((1, 1)), padded), jnp.zeros(1)) == 1.0 + 9.0


def test_bootstrap_takes_mean_or_minimum_over_all_or_a_few_drawn_anew():
    members = jnp.array([[1.0], [2.0], [4.0], [8.0]])
    key = jax.random.PRNGKey(0)
    assert bootstrap_value(members, 0, "mean", key)[0] == 3.75
    assert bootstrap_value(members, 0, "min", key)[0] == 1.0
    keys = jax.random.split(key, 300)
    drawn, means = (
        np.asarray(jax.vmap(lambda key, how=how: bootstrap_value(members, 2, how, key)[0])(keys))
        for how in ("min", "mean")
    )
    # of the 6 pairs 3 hold the least, 2 more the second, and 1 is of the two largest
    np.testing.assert_allclose(
        [np.mean(np.equal(drawn, v)) for v in (1, 2, 4)], [3 / 6, 2 / 6, 1 / 6], atol=0.12
    )
    assert set(means.tolist()) == {1.5, 2.5, 4.5, 3.0, 5.0, 6.0}


@pytest.mark.parametrize("expectile", [0.5, 0.7, 0.9])
def test_expectile_of_a_fair_coin_is_itself(expectile):
    coin = jnp.tile(jnp.array([0.0, 1.0]), 8)
    loss = lambda value, key: expectile_loss(value * jnp.ones(16), coin, expectile)  # noqa: E731
    assert abs(support.minimise(loss, jnp.float32(0.2), 400, 1e-2) - expectile) < 0.01
