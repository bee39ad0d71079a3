"""Golden examples: what a network gives for some inputs, kept in the policy file so that whoever runs it can check.

A best of N, or a critic of the gripper, is checked where rounding can't choose another winner. How far rounding moves
a critic's score is in proportion to the numbers that its output layer adds up, not to the score, which may be small.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from tandem.learner.networks import HEADS, Array, HeadConfig, Params, best_of_n, cameras, encoded, grasp
from tandem.learner.networks.mlp import Mlp, features

Floats = NDArray[np.float32]
EXAMPLES = 8  # the runtime asks for no fewer
RANGE = 3.0  # standard deviations: examples tell whether programs agree, not how float32 rounds far away
# A winner's lead over other chunks, relative to what the critics add up. Float32 and double differ by 3e-7 of that,
# and chunks that are 1e-5 off, the runtime's limit, move a score by 6e-6 of it.
CLEAR = 2e-5
SAME = 1e-6  # candidates this near are one: which of them wins does not matter
# Draws of other noise and images; from the 20th on of other observations too, from the 40th on of one noise a head.
ATTEMPTS = 50


# Run once a file: compiling takes longer than computing, so it is done without optimisation.
@partial(
    jax.jit,
    static_argnames=("architecture", "config"),
    compiler_options={"xla_backend_optimization_level": 0},
)
def policy_chunk(
    architecture: str,
    config: HeadConfig,
    params: Params,
    mean: Array,
    scale: Array,
    observation: Array,
    noise: Array,
    images: dict[str, Array],
) -> tuple[Array, Array]:
    """A whole policy: raw observations (B, O) -> chunks (B, h, A), and the winners' leads (B,), see CLEAR.

    The lead is infinite where no other candidate is another chunk.
    """
    head, x = HEADS[architecture], (observation - mean) * scale
    if isinstance(config, encoded.Config):
        encoder, params = encoded.parts(params, config)
        x = encoded.encode(encoder, config, x, images)
        head, config = config.head.head, config.head.config
    if isinstance(config, grasp.Config):
        layers, activation = params["grasp"]["layers"], config.critic.activation
        value = grasp.worth(layers, activation, x)
        lead = jnp.abs(value[grasp.CLOSED] - value[grasp.OPEN])
        return head.chunk(params, config, x, noise, images), lead / _terms(layers, activation, x.T)
    if not isinstance(config, best_of_n.Config):
        return head.chunk(params, config, x, noise, images), jnp.full(len(x), jnp.inf)
    proposed = best_of_n.candidates(params, config, x, noise, images)
    critic = best_of_n.stacked(params["critic"])
    score = best_of_n.scores(critic, config.critic, x, proposed)  # (B, N)
    chosen = best_of_n.choose(score, proposed)
    is_other = jnp.abs(proposed - chosen[:, None]).max(axis=(2, 3)) > SAME
    rivals = is_other & jnp.isfinite(score)
    best = jnp.where(jnp.isfinite(score), score, -jnp.inf).max(axis=1)
    lead = best - jnp.where(rivals, score, -jnp.inf).max(axis=1)
    return chosen, lead / _added_up(critic, config.critic.activation, x, chosen)


def _added_up(critic: Mlp, activation: str, x: Array, chunk: Array) -> Array:
    """(B,) sum of the magnitudes of the terms of a score; the largest of the members'."""
    inputs = jnp.concatenate([x, chunk.reshape(len(x), -1)], axis=1).T
    return jax.vmap(lambda layers: _terms(layers, activation, inputs))(critic).max(axis=0)


def _terms(layers: Mlp, activation: str, inputs: Array) -> Array:
    """(B,) sum of the magnitudes of what an output is added up of, for inputs (in, B); the largest of the outputs'."""
    output = layers[-1]
    terms = jnp.abs(output["weight"]) @ jnp.abs(features(layers, inputs, activation))
    return (terms + jnp.abs(output["bias"])[:, None]).max(axis=0)


def golden_examples(
    architecture: str,
    config: HeadConfig,
    params: Params,
    n_axes: int,
    mean: Floats,
    scale: Floats,
    generator: np.random.Generator,
    observation: Floats | None = None,
) -> dict[str, Any]:
    """observation (N, O), chunk (N, h, A), and where used noise (N, noise_size), image.{camera} (N, H, W, 3).

    observation: raw, N >= 8; drawn within 3 standard deviations when None. A best of N keeps only examples whose
    winner is clear: inputs are drawn anew until it is. Should fewer than 8 be found, because the critic hardly tells
    the candidates apart, those are repeated, and should none be, the clearest is; a training never ends for that.
    """
    if observation is None:
        drawn = generator.normal(size=(EXAMPLES, len(mean))).clip(-RANGE, RANGE)
        observation = (mean + drawn / scale).astype(np.float32)
    n = len(observation)
    decision = config.head.config if isinstance(config, encoded.Config) else config
    noise_size = HEADS[architecture].noise_size(config, n_axes)
    shapes = {f"image.{camera.name}": (n, camera.height, camera.width, 3) for camera in cameras(config)}

    examples: dict[str, Any] = {}
    lead = np.full(n, -np.inf)
    for attempt in range(ATTEMPTS):
        if attempt >= 20:
            drawn = generator.uniform(-RANGE, RANGE, observation.shape)
            observation = (mean + drawn / scale).astype(np.float32)
        fresh: dict[str, Any] = {"observation": observation}
        if noise_size > 0:
            fresh["noise"] = generator.standard_normal((n, noise_size), np.float32)
            if attempt >= 40 and isinstance(decision, best_of_n.Config):
                fresh["noise"] = _one_noise_a_head(decision, n_axes, fresh["noise"])
        fresh |= {name: generator.integers(0, 256, shape, np.uint8) for name, shape in shapes.items()}
        noise = fresh.get("noise", np.zeros((n, 0), np.float32))
        images = {name.removeprefix("image."): fresh[name] for name in shapes}
        chunk, found = policy_chunk(architecture, config, params, mean, scale, observation, noise, images)
        fresh["chunk"], found = np.asarray(chunk), np.asarray(found)
        examples = examples or fresh
        take = (found > lead) & (lead < CLEAR)
        for name, array in fresh.items():
            examples[name] = np.where(take.reshape(-1, *[1] * (array.ndim - 1)), array, examples[name])
        lead = np.where(take, found, lead)
        if (lead >= CLEAR).all():
            break
    rows = np.flatnonzero(lead >= CLEAR) if (lead >= CLEAR).any() else np.array([np.argmax(lead)])
    rows = np.resize(rows, max(len(rows), EXAMPLES))
    return {name: array[rows] for name, array in examples.items()}


def _one_noise_a_head(config: best_of_n.Config, n_axes: int, noise: Floats) -> Floats:
    """The first sample's noise for all samples of a head, the first edit's for all edits: candidates coincide."""
    sizes = [(p.samples, p.head.noise_size(p.config, n_axes)) for p in config.heads]
    if config.edit is not None:
        sizes.append((config.samples, config.horizon * n_axes))
    begin, parts = 0, []
    for samples, size in sizes:
        parts.append(np.tile(noise[:, begin : begin + size], samples))
        begin += samples * size
    return np.concatenate(parts, axis=1)
