"""The MC Q-chunk critic: values of chunks, regressed onto the returns that were really earned.

No bootstrap and no target network: Q estimates the behaviour that filled the buffer, humans included, so a rescue
raises the value of the human's actions directly.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax

from tandem.learner.networks import Array, Mlp, ensemble_values


def mean_score(critic: Mlp, x: Array, chunk: Array) -> Array:
    """The ranking score (B,): mean over the ensemble. No gradient: ranking must not bend the critic."""
    return lax.stop_gradient(ensemble_values(critic, x, chunk).mean(axis=0))


def mc_loss(critic: Mlp, x: Array, chunk: Array, mc_return: Array) -> tuple[Array, Array]:
    """Loss and ranking score (B,) of the chunks. The members' mean squared errors are summed: each learns as if alone.

    x (B, O) normalised, chunk (B, h, A) with its padding, mc_return (B,).
    """
    values = ensemble_values(critic, x, chunk)  # (M, B)
    loss = jnp.mean(jnp.square(values - mc_return), axis=1).sum()
    return loss, lax.stop_gradient(values.mean(axis=0))
