"""What a chunk is worth: an ensemble of Q(x, chunk), by itself and beside a value V(x).

mc    Q is regressed onto the return that was really earned. No bootstrap: Q estimates the behaviour that filled the
      buffer, humans included, so a rescue raises the value of the human's actions directly.
td    Q is regressed onto R + b Q'(x', chunk'), chunk' decided by the policy; Q' moves slowly (Q-chunking, RLPD).
iql   Q is regressed onto R + b V(x'), V onto an upper expectile of Q' (Kostrikov et al. 2021): never asks about a
      chunk that nobody executed.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax

from tandem.learner.networks import Array, Mlp, ensemble_values


def mean_score(critic: Mlp, x: Array, chunk: Array, activation: str = "relu") -> Array:
    """The ranking score (B,): mean over the ensemble. No gradient: ranking must not bend the critic."""
    return lax.stop_gradient(ensemble_values(critic, x, chunk, activation).mean(axis=0))


def regression_loss(values: Array, target: Array) -> Array:
    """values (M, B), target (B,). The members' mean squared errors are summed: each learns as if alone."""
    return jnp.mean(jnp.square(values - target), axis=1).sum()


def expectile_loss(value: Array, target: Array, expectile: float) -> Array:
    """value, target (B,): errors below the target weigh `expectile`, those above it the rest."""
    error = target - value
    return jnp.mean(jnp.where(error > 0, expectile, 1.0 - expectile) * jnp.square(error))


def bootstrap_value(values: Array, subset: int, aggregate: str, key: Array) -> Array:
    """Q' (B,) of target critics' values (M, B): mean or minimum over `subset` of them, drawn anew (REDQ); 0: all."""
    if subset:
        values = values[jax.random.permutation(key, len(values))[:subset]]
    return values.min(axis=0) if aggregate == "min" else values.mean(axis=0)


def grasp_loss(
    worth: Array, closed: Array, reward: Array, bootstrap: Array, next_live: Array, next_slow: Array
) -> Array:
    """Of a critic of the gripper, by double Q-learning (van Hasselt et al. 2016), as HIL-SERL has it.

    worth (2, B) of an open and a closed hand; closed (B,) which of them it was. Target: reward + bootstrap x the slow
    critic's next worth (2, B) of what the live one would choose.
    """
    columns = jnp.arange(worth.shape[1])
    target = reward + bootstrap * next_slow[next_live.argmax(axis=0), columns]
    return jnp.mean(jnp.square(worth[closed.astype(jnp.int32), columns] - lax.stop_gradient(target)))


def state_value(value: Mlp, x: Array, activation: str) -> Array:
    """V (B,); an ensemble of one that sees no chunk."""
    return ensemble_values(value, x, jnp.zeros((len(x), 0)), activation)[0]
