"""Minibatches: whose rows they hold, and how often each."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import support

from tandem.learner.buffer import RowSet
from tandem.learner.critic import mean_score
from tandem.learner.method import Method
from tandem.learner.trainer import Trainer
from tandem.learner.update import _draw

draw = jax.jit(_draw, static_argnums=(1, 3))

BATCH, PRIOR_SHARE = 16, 0.5  # of hil_serl, whose actor has every second update


def drawn(trainer, updates=4):
    """How many human and autonomous rows there were in each minibatch."""
    key = jax.random.PRNGKey(0)
    sums = []
    for update in range(updates):
        span = jnp.int32(update), jnp.int32(update + 1)
        arguments = trainer.buffer.arrays, trainer.buffer.rows, jnp.zeros(3), jnp.ones(3), key, *span
        trainer.state, one = trainer._update(trainer.state, *arguments, jnp.bool_(False))
        sums.append((float(one["human"]), float(one["autonomous"])))
    return sums


def test_minibatch_has_its_share_of_prior_rows_exactly_and_prior_rows_alone_before_training():
    trainer = Trainer(support.scenario(method="hil_serl", demonstrations=1))
    trainer.ingest(support.demonstration(0, n_steps=3))
    assert drawn(trainer) == [(0.0, 0.0), (BATCH, 0.0)] * 2
    trainer.ingest(support.episode(1, n_steps=30))
    assert drawn(trainer) == [(0.0, 0.0), (PRIOR_SHARE * BATCH, (1 - PRIOR_SHARE) * BATCH)] * 2


def test_other_rows_of_the_actor_are_ranked_anew(monkeypatch):
    """Advantages are those of the chunks that are imitated, not of the critic's minibatch."""

    def mismatch(method, trained, encoder, state, batch, q_buffer, key, warm_start):
        score = mean_score(state.critics["critic"], batch.x, batch.chunk)
        alone = jnp.where(batch.human.all(), 0.0, 1.0)
        return jnp.abs(score - q_buffer).max() + alone, jnp.zeros(len(q_buffer), bool)

    monkeypatch.setattr(Method, "actor_loss", mismatch)
    # widths of its own: the jitted function is shared by equal scenarios
    improvement = {"kind": "awr", "data": "human"}
    trainer = Trainer(support.scenario(improvement=improvement, critic={"hidden": [15]}))
    for number in range(2):
        trainer.ingest(support.demonstration(number))
    trainer.ingest(support.episode(2, n_steps=30))
    reports = []
    episode = support.episode(3, n_steps=5)
    trainer.ingest(episode)
    trainer.train(episode, lambda report: reports.append(report) or True)
    assert reports[0].n_updates == 10 and reports[0].actor_loss < 1e-6


@pytest.mark.parametrize("half_life", [0, 4])
def test_rows_are_drawn_alike_or_half_as_often_for_each_half_life_that_they_are_older(half_life):
    listed = np.array([3, 5, 7, 9, 11, 13, 15, 17, 0, 0, 0])  # the rest is room
    rows, n = RowSet(jnp.asarray(listed), jnp.int32(8)), 80_000
    found = np.asarray(draw(rows, n, jax.random.PRNGKey(0), half_life))
    share = np.array([(found == row).mean() for row in listed[:8]])
    weight = 2.0 ** (np.arange(8) / half_life) if half_life else np.ones(8)
    np.testing.assert_allclose(share, weight / weight.sum(), rtol=0.05)


@pytest.mark.parametrize("half_life", [0, 100])
def test_one_row_is_drawn_when_there_is_one(half_life):
    rows = RowSet(jnp.asarray([6, 0, 0]), jnp.int32(1))
    assert (np.asarray(draw(rows, 50, jax.random.PRNGKey(0), half_life)) == 6).all()
