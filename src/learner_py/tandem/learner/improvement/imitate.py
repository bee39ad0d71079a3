"""Plain imitation of the rows that the method draws: all, the human's, the demonstrations', or those of successes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp

from tandem.learner.networks import Array

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    # the human's own steps only, when only those are to be imitated; a window may run into autonomous ones
    mask = batch.human if method.config.learner.improvement.data == "human" else batch.valid
    value = method.actor.imitation_loss(trained["actor"], batch.x, batch.chunk, mask, key)
    return value, jnp.zeros(len(batch.x), bool)
