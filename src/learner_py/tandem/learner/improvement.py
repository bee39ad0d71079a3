"""How the actor improves: max-Q selective imitation, or plain imitation.

Both regress the policy's chunk onto a target chunk, step by step, padding masked. With a deterministic head a win of
the policy is a target equal to its own output, so it has no gradient: max-Q teaches exactly where the logged chunk
scores higher. Improvement beyond the human comes from exploration that wins.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax

from tandem.learner.networks import Array


def max_q_target(
    q_policy: Array, q_buffer: Array, policy_chunk: Array, buffer_chunk: Array
) -> tuple[Array, Array]:
    """Hard winner of the two candidates at each state (paper, eq. 1).

    scores (B,), chunks (B, h, A) -> target (B, h, A), policy_wins (B,).
    Ties go to the policy: with equal value there is nothing to learn from the buffer.
    """
    policy_wins = q_policy >= q_buffer
    target = jnp.where(policy_wins[:, None, None], policy_chunk, buffer_chunk)
    return lax.stop_gradient(target), policy_wins


def imitation_loss(policy_chunk: Array, target: Array, mask: Array) -> Array:
    """Mean over batch, steps and axes of the squared error; masked steps (B, h) count as zero error.

    Dividing by all elements, not by the valid ones, gives every real action the same weight wherever it stands.
    """
    error = jnp.square(policy_chunk - target) * mask[:, :, None]
    return error.mean()
