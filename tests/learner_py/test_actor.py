"""Imitation by every head, on targets whose best answer is known."""

from __future__ import annotations

import heads
import jax
import jax.numpy as jnp
import numpy as np
import support

from tandem.learner.actor import Actor
from tandem.learner.method import Method
from tandem.learner.networks import HEADS

N = 128


def actor_of(kind: str, **settings) -> Actor:
    return Method(support.scenario(method="bc", horizon=1, head={"kind": kind, kind: settings})).actor


def imitating(actor, target_of, steps=800, rate=5e-3, n=N):
    """Parameters after imitation of target_of(x, key), x uniform in [-1, 1]."""

    def loss(params, key):
        key_x, key_target, key_loss = jax.random.split(key, 3)
        x = jax.random.uniform(key_x, (n, 3), minval=-1.0, maxval=1.0)
        target = target_of(x, key_target)[:, None]
        return actor.imitation_loss(params, x, target, jnp.ones((n, 1)), key_loss)

    return support.minimise(loss, actor.init(np.random.default_rng(0)), steps, rate)


def sampled(actor, params, x):
    function = heads.jitted(lambda params, _, x, key: actor.sample(params, x, key))
    return np.asarray(function(params, 0, x, jax.random.PRNGKey(7)))[:, 0]


def one_of_two(x, key):
    """Left or right by 0.7, as often, whatever is seen."""
    return jnp.where(jax.random.bernoulli(key, shape=(len(x), 1)), 0.7, -0.7) * jnp.ones(3)


def test_flow_samples_both_of_two_ways_and_an_mlp_goes_between_them():
    x = np.zeros((400, 3), np.float32)
    flow = actor_of("flow", hidden=[48], steps=8)
    way = sampled(flow, imitating(flow, one_of_two), x)[:, 0]
    assert 0.3 < (way > 0).mean() < 0.7
    assert (np.abs(np.abs(way) - 0.7) < 0.25).mean() > 0.8
    mlp = actor_of("mlp")
    assert np.abs(sampled(mlp, imitating(mlp, one_of_two, steps=300), x[:1])).max() < 0.15


def test_gaussian_recovers_mean_and_standard_deviation():
    mean, deviation = jnp.array([0.4, 0.0, -0.3]), jnp.array([0.2, 0.1, 0.3])
    gaussian = actor_of("gaussian")
    params = imitating(
        gaussian,
        lambda x, key: jnp.tanh(mean + deviation * jax.random.normal(key, (len(x), 3))),
        steps=2000,
        rate=1e-3,
    )
    chunk = heads.jitted(HEADS["gaussian"].chunk)
    x = np.random.default_rng(1).uniform(-1, 1, (100, 3)).astype(np.float32)
    for noise in (0.0, 1.0, -1.0):
        drawn = np.arctanh(chunk(params, gaussian.config, x, np.full((100, 3), noise, np.float32), {}))
        np.testing.assert_allclose(drawn[:, 0].mean(axis=0), mean + noise * deviation, atol=0.04)


def test_act_learns_to_repeat_what_it_sees():
    act = actor_of("act")
    params = imitating(act, lambda x, key: 0.8 * x, steps=400, rate=1e-2, n=48)
    x = np.random.default_rng(1).uniform(-0.9, 0.9, (50, 3)).astype(np.float32)
    assert np.abs(sampled(act, params, x) - 0.8 * x).mean() < 0.06


def test_act_that_draws_samples_both_of_two_ways():
    act = actor_of("act", sample_latent=True)
    params = imitating(act, one_of_two, steps=400, rate=3e-3, n=48)
    way = sampled(act, params, np.zeros((200, 3), np.float32))[:, 0]
    assert 0.3 < (way > 0).mean() < 0.7
    assert (np.abs(np.abs(way) - 0.7) < 0.25).mean() > 0.65


def test_imitation_masks_the_padding():
    actor = Method(support.scenario(method="bc", horizon=2, head={"kind": "mlp"})).actor
    params = jax.tree.map(jnp.zeros_like, actor.init(np.random.default_rng(0)))  # always zero
    target = jnp.array([[[0.5] * 3, [1.0] * 3]])
    loss = actor.imitation_loss(params, jnp.zeros((1, 3)), target, jnp.array([[True, False]]), None)
    assert loss == 0.5 * 0.25
