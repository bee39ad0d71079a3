"""Max-Q selective imitation (the paper, eq. 1): the actor imitates the better of its own chunk and the logged one.

With a deterministic head a win of the policy is a target equal to its own output, which has no gradient: max-Q teaches
exactly where the logged chunk scores higher, and improvement beyond the human comes from exploration that wins. A flow
would be trained on its own samples; unless `imitate_self` asks for that, its wins are left out too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import lax

from tandem.learner.networks import Array

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    settings = method.config.learner.improvement.max_q
    key_own, key_error = jax.random.split(key)
    own = lax.stop_gradient(method.actor.sample(trained["actor"], batch.x, key_own))
    values = method.values(fixed["critic"], batch.x, own)
    q_policy = values.mean(axis=0) - settings.pessimism * values.std(axis=0)
    q_logged = batch.mc_return if settings.buffer_score == "return" else q_buffer
    # Ties go to the policy: with equal value there is nothing to learn from the buffer.
    policy_wins = q_policy >= q_logged
    if settings.imitate_self:
        target, weight = jnp.where(policy_wins[:, None, None], own, batch.chunk), batch.valid
    else:
        target, weight = batch.chunk, batch.valid & ~policy_wins[:, None]
    return method.actor.imitation_loss(trained["actor"], batch.x, target, weight, key_error), policy_wins
