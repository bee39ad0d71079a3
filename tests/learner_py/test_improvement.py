"""How actors improve, on critics made by hand."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import support

from tandem.learner.critic import mean_score
from tandem.learner.improvement import LOSSES, imitate
from tandem.learner.improvement.e2hil import entropy_influence
from tandem.learner.improvement.sac import init_temperature, temperature_loss
from tandem.learner.method import Method
from tandem.learner.networks import best_of_n
from tandem.learner.networks.gaussian import sample_with_log_prob, squashed_log_prob

KEY = jax.random.PRNGKey(0)
LIKES_LARGE, LIKES_SMALL, LIKES_NOTHING = ([0.0] * 3 + [slope] * 3 for slope in (1.0, -1.0, 0.0))


def method_of(kind, head="mlp", **improvement):
    decision = {"kind": "best_of_n"} if kind == "expo" else {}
    changes = {"kind": kind} | improvement
    return Method(support.scenario(head={"kind": head}, improvement=changes, decision=decision))


def largest(gradient):
    return max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(gradient))


def first_step(method, *members, warm_start=False, **rows):
    """The actor's gradient on four rows that logged 0.9, and who won; critics linear in (x, chunk)."""
    state = method.init(seed=0)
    batch = support.batch(4, **({"chunk": np.full((4, 1, 3), 0.9)} | rows))
    critic = support.linear_critics(*members)
    state = state._replace(critics={**state.critics, "critic": critic})
    q_buffer = mean_score(critic, batch.x, batch.chunk)
    step = jax.value_and_grad(method.actor_loss, has_aux=True)
    (_, wins), gradient = support.quickly(
        lambda actors: step(actors, {}, state, batch, q_buffer, KEY, warm_start)
    )(state.actors)
    return gradient, np.asarray(wins)


def with_values(monkeypatch, value_of):
    """Critics whose value of a chunk (B, h, A) is value_of(chunk) (B,)."""
    monkeypatch.setattr(Method, "values", lambda method, critic, x, chunk: value_of(chunk)[None])


def improved(method, batch, steps=600, rate=1e-2, fixed=None):
    """The actor's networks after steps of its own loss, the critic as it is; a warm start is none."""
    state, loss = method.init(seed=0), LOSSES[method.config.learner.improvement.kind]
    zero = jnp.zeros(len(batch.x))
    return support.minimise(
        lambda trained, key: loss(method, trained, fixed or state.critics, batch, zero, key)[0],
        state.actors,
        steps,
        rate,
    )


# ---- max-Q


def test_logged_action_that_scores_higher_is_imitated():
    gradient, wins = first_step(method_of("max_q"), LIKES_LARGE)
    assert not wins.any() and largest(gradient) > 1e-3


def test_policy_that_wins_has_no_gradient_and_wins_ties():
    for critic in (LIKES_SMALL, LIKES_NOTHING):
        gradient, wins = first_step(method_of("max_q"), critic)
        assert wins.all() and largest(gradient) == 0.0


def test_warm_start_imitates_whoever_would_win():
    gradient, _ = first_step(method_of("max_q"), LIKES_SMALL, warm_start=True)
    assert largest(gradient) > 1e-3


def test_flow_that_wins_learns_its_own_samples_only_when_asked():
    gradient, wins = first_step(method_of("max_q", "flow"), LIKES_SMALL, chunk=np.full((4, 1, 3), 1.0))
    assert wins.all() and largest(gradient) == 0.0
    gradient, wins = first_step(
        method_of("max_q", "flow", max_q={"imitate_self": True}), LIKES_SMALL, chunk=np.full((4, 1, 3), 1.0)
    )
    assert wins.all() and largest(gradient) > 1e-3


def test_winner_is_decided_row_by_row():
    logged = np.array([0.9, -0.9, 0.9, -0.9])[:, None, None] * np.ones((4, 1, 3))
    _, wins = first_step(method_of("max_q"), LIKES_LARGE, chunk=logged)
    np.testing.assert_array_equal(wins, [False, True, False, True])


def test_pessimism_lowers_the_policys_score_by_the_ensembles_spread():
    # of one mind about the logged chunk, of two about the policy's: 2 and -1 at zero, in the mean 0.5 above the logged
    member = [2.0 / 3.0] * 3, [-1.0 / 3.0] * 3
    critics = [[*part, *[-part[0] / 0.9] * 3] for part in member]
    for pessimism, wins_expected in ((0.0, True), (0.2, True), (0.5, False)):
        method = method_of("max_q", max_q={"pessimism": pessimism})
        _, wins = first_step(method, *critics, chunk=np.full((4, 1, 3), 0.9))
        assert (wins == wins_expected).all(), pessimism


def test_return_that_was_earned_can_stand_for_the_critics_score_of_the_logged_chunk():
    earned = np.array([-5.0, 5.0, -5.0, 5.0])
    _, wins = first_step(method_of("max_q", max_q={"buffer_score": "return"}), LIKES_LARGE, mc_return=earned)
    np.testing.assert_array_equal(wins, earned < 0)


# ---- imitation, plain and weighted


def test_human_steps_alone_are_imitated_when_the_data_are_the_humans():
    human = np.array([True, False, True, False])[:, None]
    batch = support.batch(
        4, chunk=np.array([0.5, 1.0, 0.5, 1.0])[:, None, None] * np.ones((4, 1, 3)), human=human
    )
    losses = {}
    for data in ("all", "human"):
        method = method_of("imitate", data=data)
        zero = jax.tree.map(jnp.zeros_like, method.init(0).actors)
        losses[data] = float(imitate.loss(method, zero, {}, batch, jnp.zeros(4), KEY)[0])
    assert losses == {"all": (0.25 + 1.0) / 2, "human": 0.25 / 2}


def test_awr_weighs_by_the_exponential_of_the_advantage_up_to_its_limit():
    method = method_of("awr", awr={"inverse_temperature": 2.0, "weight_limit": 5.0})
    actors = jax.tree.map(jnp.zeros_like, method.init(0).actors)
    state_value = [{"weight": jnp.zeros((1, 1, 3)), "bias": jnp.full((1, 1), 0.25)}]
    chunk = np.array([0.1, 0.2, 0.4, 0.8])
    q = np.array([-1.0, 0.25, 0.75, 9.0])
    batch = support.batch(4, chunk=chunk[:, None, None] * np.ones((4, 1, 3)))
    loss, wins = LOSSES["awr"](method, actors, {"value": state_value}, batch, jnp.asarray(q), KEY)
    weight = np.minimum(np.exp(2.0 * (q - 0.25)), 5.0)
    np.testing.assert_allclose(weight, [math.exp(-2.5), 1.0, math.e, 5.0])
    np.testing.assert_allclose(loss, np.mean(weight * chunk**2), rtol=1e-5)
    assert not wins.any()


# ---- up the critic's slope


def quadratic(chunk):
    """Best at 0.3 in every axis."""
    return -jnp.square(chunk - 0.3).sum(axis=(1, 2))


def test_q_gradient_climbs_to_the_critics_optimum(monkeypatch):
    with_values(monkeypatch, quadratic)
    method = method_of("q_gradient")
    actor = improved(method, support.batch(8), steps=300)["actor"]
    np.testing.assert_allclose(method.actor.sample(actor, jnp.ones((1, 3)), KEY), 0.3, atol=0.02)


def test_sac_goes_to_the_optimum_and_narrows_when_entropy_is_cheap(monkeypatch):
    with_values(monkeypatch, lambda chunk: 10.0 * quadratic(chunk))
    method = method_of("sac", "gaussian", sac={"initial_temperature": 1e-4, "target_entropy_per_axis": -5.0})
    actor = improved(method, support.batch(64), steps=500)["actor"]
    chunk = np.asarray(method.actor.sample(actor, jnp.ones((200, 3)), KEY))
    np.testing.assert_allclose(chunk.mean(axis=(0, 1)), 0.3, atol=0.04)
    assert chunk.std(axis=0).max() < 0.15


@pytest.mark.parametrize("target", [-0.5, -1.5])
def test_entropy_comes_to_its_target_on_a_flat_critic(monkeypatch, target):
    with_values(
        monkeypatch, lambda chunk: 0.0 * chunk.sum(axis=(1, 2)) - 2.0 * jnp.square(chunk).sum(axis=(1, 2))
    )
    method = method_of("sac", "gaussian", sac={"initial_temperature": 0.1, "target_entropy_per_axis": target})
    assert method.target_entropy == 3 * target
    actor = improved(method, support.batch(64), steps=1500)["actor"]
    _, log_prob = sample_with_log_prob(actor, method.actor.config, jnp.ones((4000, 3)), KEY)
    assert abs(-float(log_prob.mean()) - 3 * target) < 0.25


def test_temperature_falls_with_too_much_entropy_and_rises_with_too_little():
    temperature = init_temperature(0.1)
    assert abs(float(jax.nn.softplus(temperature["raw"])) - 0.1) < 1e-6
    slope = jax.grad(lambda t, log_prob: temperature_loss(t, log_prob, -1.0))
    assert slope(temperature, jnp.array([0.0]))["raw"] > 0  # entropy 0
    assert slope(temperature, jnp.array([3.0]))["raw"] < 0  # entropy -3


def test_density_of_the_squashed_normal_is_a_density_and_the_change_of_variables():
    mean, deviation = 0.7, 0.5
    noise = np.linspace(-7, 7, 4001)[:, None]
    point, log_prob = squashed_log_prob(
        jnp.full((4001, 1), mean), jnp.log(jnp.full((4001, 1), deviation)), noise
    )
    point, density = np.asarray(point[:, 0], np.float64), np.exp(np.asarray(log_prob, np.float64))
    assert abs(np.trapezoid(density, point) - 1.0) < 1e-3
    inside = np.abs(point) < 0.999
    z = (np.arctanh(point[inside]) - mean) / deviation
    expected = np.exp(-0.5 * z**2) / (deviation * np.sqrt(2 * np.pi)) / (1 - point[inside] ** 2)
    np.testing.assert_allclose(density[inside], expected, rtol=5e-3)


def test_density_far_out_stays_finite():
    _, log_prob = squashed_log_prob(jnp.array([[30.0]]), jnp.array([[0.0]]), jnp.zeros((1, 1)))
    # 1 - tanh(30)^2 = 4 exp(-60)
    assert abs(float(log_prob[0]) - (-0.5 * math.log(2 * math.pi) - math.log(4.0) + 60.0)) < 1e-3


# ---- E2HiL


def influence(gains, log_probs):
    """c = -Cov_k(log pi, p A), p limited to 1e6, with numpy."""
    weighted = np.minimum(np.exp(log_probs), 1e6) * (gains - gains.mean(axis=0))
    return np.array(
        [-np.cov(log_probs[:, b], weighted[:, b], bias=True)[0, 1] for b in range(gains.shape[1])]
    )


def test_entropy_influence_is_the_formula():
    generator = np.random.default_rng(0)
    gains, log_probs = generator.normal(size=(8, 5)), generator.normal(size=(8, 5))
    log_probs[:, 4] += 20.0  # densities beyond their limit
    np.testing.assert_allclose(entropy_influence(gains, log_probs), influence(gains, log_probs), rtol=1e-3)


def test_e2hil_learns_only_from_states_of_moderate_influence(monkeypatch):
    """The critic here is a slope for each state; whoever's slope has a gradient was learnt from."""
    n, samples = 8, 4
    quantiles = {"samples": samples, "low_quantile": 0.25, "high_quantile": 0.8}
    method = method_of("e2hil", "gaussian", e2hil=quantiles)
    monkeypatch.setattr(
        Method, "values", lambda method, slope, x, chunk: (slope * chunk.sum(axis=(1, 2)))[None]
    )
    x = np.random.default_rng(0).normal(size=(n, 3))
    batch, slope = support.batch(n, x=x), jnp.linspace(0.2, 3.0, n)
    state = method.init(seed=0)

    def loss(slope):
        return LOSSES["e2hil"](method, state.actors, {"critic": slope}, batch, jnp.zeros(n), KEY)[0]

    is_kept = np.asarray(support.quickly(jax.grad(loss))(slope)) != 0
    drawn = [
        sample_with_log_prob(state.actors["actor"], method.actor.config, batch.x, key)
        for key in jax.random.split(KEY, samples)
    ]
    log_probs = np.array([log_prob for _, log_prob in drawn])
    gains = np.array([slope * chunk.sum(axis=(1, 2)) for chunk, _ in drawn]) - 0.01 * log_probs
    size = np.abs(influence(gains, log_probs))
    low, high = np.quantile(size, [0.25, 0.8])
    np.testing.assert_array_equal(is_kept, (size >= low) & (size <= high))
    assert 3 <= is_kept.sum() < n


# ---- EXPO


def test_expo_edits_climb_the_critic_within_their_scale_and_the_base_only_imitates(monkeypatch):
    with_values(monkeypatch, lambda chunk: chunk.sum(axis=(1, 2)))
    method = method_of("expo", sac={"initial_temperature": 1e-3}, edit={"scale": 0.2})
    batch = support.batch(32, chunk=np.linspace(-0.9, 0.9, 32)[:, None, None] * np.ones((32, 1, 3)))
    zero, state = jnp.zeros(32), method.init(seed=0)

    def gradient(kind):
        loss = LOSSES[kind]
        return support.quickly(
            jax.grad(lambda actors: loss(method, actors, {"critic": None}, batch, zero, KEY)[0])
        )(state.actors)

    whole, alone = gradient("expo"), gradient("imitate")
    for ours, theirs in zip(jax.tree.leaves(whole["actor"]), jax.tree.leaves(alone["actor"]), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert largest(whole["edit"]) > 1e-3

    trained = improved(method, batch, steps=300, fixed={"critic": None})
    edited = best_of_n.edit(
        trained["edit"],
        method.deployed[1].edit,
        batch.x,
        batch.chunk[:, None],
        jax.random.normal(KEY, (32, 3)),
    )
    change = np.asarray(edited[:, 0] - batch.chunk)
    assert np.abs(change).max() <= 0.2 + 1e-6 and np.abs(edited).max() <= 1.0
    assert change[np.abs(batch.chunk[:, 0, 0]) < 0.75].mean() > 0.12


def test_entropy_of_expos_edits_can_reach_its_target_whatever_their_scale(monkeypatch):
    """Otherwise its price rises without end and the edits are noise."""
    with_values(monkeypatch, lambda chunk: 0.0 * chunk.sum(axis=(1, 2)))
    method = method_of("expo", sac={"initial_temperature": 0.5}, edit={"scale": 0.05})
    trained = improved(method, support.batch(32), steps=300, fixed={"critic": None})
    assert jax.nn.softplus(trained["temperature"]["raw"]) < 0.5
