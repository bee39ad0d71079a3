"""Soft actor-critic (Haarnoja et al. 2018) as RLPD and HIL-SERL have it: up the mean Q, entropy at a learnt price.

actor        alpha log pi(a | x) - Q(x, a),  a ~ pi
temperature  alpha (H(pi) - H_target), H_target = target_entropy_per_axis x h x A
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from tandem.learner.networks import Array, Params
from tandem.learner.networks.base import array
from tandem.learner.networks.gaussian import sample_with_log_prob

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def init_temperature(initial: float) -> Params:
    """alpha = softplus(raw)"""
    return {"raw": array(np.log(np.expm1(initial)))}


def temperature_loss(temperature: Params, log_prob: Array, target_entropy: float) -> Array:
    alpha = jax.nn.softplus(temperature["raw"])
    return alpha * lax.stop_gradient(-log_prob.mean() - target_entropy)


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    chunk, log_prob = sample_with_log_prob(trained["actor"], method.actor.config, batch.x, key)
    q_policy = method.values(fixed["critic"], batch.x, chunk).mean(axis=0)
    alpha = lax.stop_gradient(jax.nn.softplus(trained["temperature"]["raw"]))
    value = jnp.mean(alpha * log_prob - q_policy)
    return value + temperature_loss(
        trained["temperature"], log_prob, method.target_entropy
    ), q_policy >= q_buffer
