"""E2HiL (arXiv 2601.19969): soft actor-critic without the samples that move the policy's entropy hardly or too much.

At each state K actions are drawn; how the update would move the entropy there is c = -Cov_k(log pi, pi A), with
A = Q - alpha log pi less its mean. Only states whose |c| lies between two quantiles of the batch are learnt from. The
public code never calls this; it is made from the paper's formulas.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import lax

from tandem.learner.improvement.sac import temperature_loss
from tandem.learner.networks import Array
from tandem.learner.networks.gaussian import sample_with_log_prob

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks

LARGEST_DENSITY = 1e6


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    settings = method.config.learner.improvement.e2hil
    alpha = lax.stop_gradient(jax.nn.softplus(trained["temperature"]["raw"]))

    def gain(sample_key: Array) -> tuple[Array, Array, Array]:
        chunk, log_prob = sample_with_log_prob(trained["actor"], method.actor.config, batch.x, sample_key)
        q_policy = method.values(fixed["critic"], batch.x, chunk).min(axis=0)
        return q_policy - alpha * log_prob, log_prob, q_policy

    # the first of the K samples is the one that teaches
    gains, log_probs, q_policies = jax.vmap(gain)(jax.random.split(key, settings.samples))  # (K, B)
    influence = jnp.abs(entropy_influence(lax.stop_gradient(gains), lax.stop_gradient(log_probs)))
    low, high = jnp.quantile(influence, jnp.array([settings.low_quantile, settings.high_quantile]))
    is_kept = (influence >= low) & (influence <= high)
    value = -(gains[0] * is_kept).sum() / (is_kept.sum() + 1e-8)
    return value + temperature_loss(trained["temperature"], log_probs[0], method.target_entropy), q_policies[
        0
    ] >= q_buffer


def entropy_influence(gains: Array, log_probs: Array) -> Array:
    """c (B,) of K samples' gains and log-densities (K, B)."""
    weighted = jnp.minimum(jnp.exp(log_probs), LARGEST_DENSITY) * (gains - gains.mean(axis=0))
    centred = log_probs - log_probs.mean(axis=0)
    return -(centred * (weighted - weighted.mean(axis=0))).mean(axis=0)
