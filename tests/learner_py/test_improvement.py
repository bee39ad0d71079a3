"""Max-Q selective imitation on critics made by hand, and what each method imitates."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import support

from tandem.learner.critic import mc_loss, mean_score
from tandem.learner.improvement import imitation_loss, max_q_target
from tandem.learner.method import Batch, Method
from tandem.learner.networks import ensemble_values


def linear_critics(*weights):
    """Members whose value is w . (x, chunk)."""
    return [{"weight": jnp.array(weights, jnp.float32)[:, None, :], "bias": jnp.zeros((len(weights), 1))}]


def test_winner_is_the_higher_value_and_ties_go_to_the_policy():
    policy, logged = jnp.full((3, 1, 2), 0.5), jnp.full((3, 1, 2), -0.5)
    target, wins = max_q_target(jnp.array([1.0, 0.0, 2.0]), jnp.array([0.0, 1.0, 2.0]), policy, logged)
    np.testing.assert_array_equal(wins, [True, False, True])
    np.testing.assert_array_equal(target[:, 0, 0], [0.5, -0.5, 0.5])


def test_ranking_uses_the_mean_of_the_ensemble():
    # one member prefers large actions mildly, the other small ones strongly
    critic = linear_critics([0.0, 1.0], [0.0, -3.0])
    x, low, high = jnp.zeros((1, 1)), jnp.full((1, 1, 1), -0.5), jnp.full((1, 1, 1), 0.5)
    assert mean_score(critic, x, low)[0] > mean_score(critic, x, high)[0]
    np.testing.assert_allclose(ensemble_values(critic, x, high), [[0.5], [-1.5]])


def actor_gradient(value_of_action: float, warm_start: bool, logged: float = 0.9):
    """Gradient of the actor's loss where a hand-made critic likes large (or small) actions."""
    method = Method(support.scenario())
    state = method.init(seed=0)
    batch = Batch(
        x=jnp.ones((4, 3)), chunk=jnp.full((4, 1, 3), logged), valid=jnp.ones((4, 1), bool),
        human=jnp.zeros((4, 1), bool), mc_return=jnp.zeros(4),
    )  # fmt: skip
    critic = linear_critics([0.0] * 3 + [value_of_action] * 3)
    q_buffer = mean_score(critic, batch.x, batch.chunk)
    (_, wins), gradient = jax.value_and_grad(method.actor_loss, has_aux=True)(
        state.actor, critic, batch, q_buffer, jnp.bool_(warm_start)
    )
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(gradient)]), np.asarray(wins)


def test_logged_action_that_scores_higher_is_imitated():
    gradient, wins = actor_gradient(value_of_action=1.0, warm_start=False)
    assert not wins.any() and np.abs(gradient).max() > 1e-3


def test_policy_that_wins_has_no_gradient():
    gradient, wins = actor_gradient(value_of_action=-1.0, warm_start=False)
    assert wins.all() and not gradient.any()


def test_tie_has_no_gradient():
    gradient, wins = actor_gradient(value_of_action=0.0, warm_start=False)
    assert wins.all() and not gradient.any()


def test_warm_start_imitates_whoever_wins():
    gradient, wins = actor_gradient(value_of_action=-1.0, warm_start=True)
    assert wins.all() and np.abs(gradient).max() > 1e-3


def test_actor_gradient_never_flows_through_the_critic():
    critic = linear_critics([0.0, 1.0])
    gradient = jax.grad(lambda chunk: mean_score(critic, jnp.zeros((1, 1)), chunk).sum())(
        jnp.zeros((1, 1, 1))
    )
    assert not gradient.any()


def test_imitation_masks_the_padding_but_the_critic_sees_it():
    chunk, target = jnp.zeros((1, 2, 1)), jnp.array([[[0.5], [1.0]]])
    assert imitation_loss(chunk, target, jnp.array([[True, False]])) == 0.5 * 0.25
    critic = linear_critics([0.0, 0.0, 1.0])
    loss, _ = mc_loss(critic, jnp.zeros((1, 1)), target, jnp.zeros(1))
    assert loss == 1.0


def rows(method_name: str):
    method = Method(support.scenario(method=method_name))
    shown = support.demonstration(0, n_steps=2)
    helped = support.episode(1, n_steps=4, intervention=[0, 1, 1, 0])
    return [list(method.eligible(e, method.windows(e))) for e in (shown, helped)]


def test_each_method_draws_from_its_own_data():
    assert rows("tandem") == [[True] * 2, [True] * 4]
    assert rows("hg_dagger") == [[True] * 2, [False, True, True, False]]
    assert rows("bc") == [[True] * 2, [False] * 4]


def test_only_tandem_cuts_returns_at_interventions():
    helped = support.episode(1, n_steps=4, intervention=[0, 1, 1, 0])
    cut = {
        name: Method(support.scenario(method=name)).windows(helped).mc_return[0] == 0
        for name in ("tandem", "mcbc")
    }
    assert cut == {"tandem": True, "mcbc": False}
