"""EXPO (arXiv 2507.07986): an expressive base that only imitates everything, and a small edit that climbs the critic.

The edit is a tanh-Gaussian of [x, chunk], at most `scale` in each number, trained as in soft actor-critic on the logged
chunks. Acting, and the critic's next chunk, take the best among the base's samples and their edits. (Base here: the
method's head, a flow; the original's is a diffusion.)

The edit's entropy is counted before it is scaled, as with the original's `adjust_target_entropy`: a change within +-0.1
can't have -0.5 an axis, so alpha would rise without end and the edits be noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jax import lax

from tandem.learner.improvement import imitate
from tandem.learner.improvement.sac import temperature_loss
from tandem.learner.networks import Array
from tandem.learner.networks.gaussian import squashed_log_prob
from tandem.learner.networks.mlp import forward

if TYPE_CHECKING:
    from tandem.learner.method import Batch, Method, Networks


def loss(
    method: Method, trained: Networks, fixed: Networks, batch: Batch, q_buffer: Array, key: Array
) -> tuple[Array, Array]:
    settings = method.config.learner.improvement.edit
    key_base, key_edit = jax.random.split(key)
    base, _ = imitate.loss(method, trained, fixed, batch, q_buffer, key_base)

    flat = batch.chunk.reshape(len(batch.x), -1)
    inputs = jnp.concatenate([batch.x, flat], axis=1)
    mean, raw = jnp.split(forward(trained["edit"]["layers"], inputs.T, settings.activation).T, 2, axis=1)
    log_std = jnp.clip(raw, settings.log_std_min, settings.log_std_max)
    change, log_prob = squashed_log_prob(mean, log_std, jax.random.normal(key_edit, mean.shape))
    edited = jnp.clip(flat + settings.scale * change, -1.0, 1.0).reshape(batch.chunk.shape)
    q_edited = method.values(fixed["critic"], batch.x, edited).mean(axis=0)
    alpha = lax.stop_gradient(jax.nn.softplus(trained["temperature"]["raw"]))
    edit = jnp.mean(alpha * log_prob - q_edited)
    temperature = temperature_loss(trained["temperature"], log_prob, method.target_entropy)
    return base + edit + temperature, q_edited >= q_buffer
