"""The work of both contenders, an .npz file: initial parameters, rows of a buffer, one minibatch with its noise.

    settings        JSON: batch, learning_rate, weight_decay, ema, time_features, activation is ReLU everywhere
    rows.*          observation (R, O) normalised, chunk (R, h, A), mc_return (R,)
    critic.L.NAME   an array of layer L of all members (M, ...); actor.L.NAME of the flow's field
    noise, time     (B, h, A), (B,): for the losses that are compared, of rows 0 .. B-1

Counted operations: matrix products only, a multiply-add as two.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from tandem.learner.config import LearnerScenario
from tandem.learner.method import Method

N_ROWS = 6000  # what a run on the peg has at its end

Floats = NDArray[Any]


class WorkError(Exception):
    """A sentence: what this benchmark can't be made of."""


def write(path: Path, scenario: LearnerScenario) -> None:
    """Random rows and the first parameters of the scenario's method; one that imitates by an MLP flow beside an MC
    critic, which is what bench/learner/torch_update.py can do."""
    method = Method(scenario)
    learner = scenario.method.learner
    parts = (learner.head.kind, learner.critic.kind, learner.improvement.kind)
    if parts != ("flow", "mc", "imitate"):
        raise WorkError(
            f"method.learner has head, critic and improvement {', '.join(parts)};"
            " this benchmark's peer knows flow, mc, imitate alone."
        )
    state = method.init(scenario.run.seed)
    generator = np.random.default_rng(0)
    chunk = (scenario.method.horizon, method.n_axes)
    key_noise, key_time = jax.random.split(noise_key())  # as flow.imitation_error does
    arrays: dict[str, Any] = {
        "rows.observation": generator.standard_normal((N_ROWS, method.actor.n_observation)),
        "rows.chunk": generator.uniform(-1, 1, (N_ROWS, *chunk)),
        "rows.mc_return": generator.uniform(0, 1, N_ROWS),
        "noise": jax.random.normal(key_noise, (learner.replay.batch, *chunk)),
        "time": jax.random.uniform(key_time, (learner.replay.batch,)),
    }
    for name, layers in (("critic", state.critics["critic"]), ("actor", state.actors["actor"]["layers"])):
        for index, layer in enumerate(layers):
            arrays |= {f"{name}.{index}.{key}": value for key, value in layer.items()}
    settings = {
        "batch": learner.replay.batch,
        "learning_rate": learner.learning_rate,
        "weight_decay": learner.critic.weight_decay,
        "ema": learner.ema,
        "time_features": learner.head.flow.time_features,
    }
    as_floats: dict[str, Any] = {name: np.asarray(value, np.float32) for name, value in arrays.items()}
    np.savez(path, settings=json.dumps(settings), **as_floats)


def noise_key() -> jax.Array:
    """Of the noise and times that the compared losses are made with."""
    return jax.random.PRNGKey(0)


def flops(scenario: LearnerScenario) -> int:
    """Of one update: forward, gradient of weights, gradient of inputs (not of the first layer)."""
    method, learner = Method(scenario), scenario.method.learner
    n_obs, n_chunk = method.actor.n_observation, scenario.method.horizon * method.n_axes
    critic = _trained([n_obs + n_chunk, *learner.critic.hidden, 1], learner.replay.batch)
    flow = learner.head.flow
    field = _trained([n_obs + n_chunk + flow.time_features, *flow.hidden, n_chunk], learner.replay.batch)
    return learner.critic.members * critic + field


def _trained(sizes: Sequence[int], batch: int) -> int:
    products = [2 * n_in * n_out * batch for n_in, n_out in pairwise(sizes)]
    return 3 * sum(products) - products[0]
