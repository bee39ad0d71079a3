"""Advantage-weighted imitation: chunks count exp(advantage / temperature), limited (AWR; the actor of IQL).

The advantage is Q(x, chunk) - V(x), whatever critic they are of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp

from tandem.learner.networks import Array

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    settings = method.config.learner.improvement.awr
    advantage = q_buffer - method.state_value(fixed["value"], batch.x)
    weight = jnp.minimum(jnp.exp(settings.inverse_temperature * advantage), settings.weight_limit)
    value = method.actor.imitation_loss(
        trained["actor"], batch.x, batch.chunk, batch.valid * weight[:, None], key
    )
    return value, jnp.zeros(len(batch.x), bool)
