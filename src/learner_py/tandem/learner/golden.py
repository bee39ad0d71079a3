"""Golden examples: what a network gives for some inputs, kept in the policy file so that whoever runs it can check."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from tandem.learner.networks import HEADS, Array, HeadConfig, Params, best_of_n, cameras
from tandem.policy_file import PolicyFileError

Floats = NDArray[np.float32]
EXAMPLES = 8  # the runtime asks for no fewer
RANGE = 3.0  # standard deviations: examples tell whether programs agree, not how float32 rounds far away
CLEAR = 1e-3  # a winner's lead over every other score, relative
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
    """A whole policy: raw observations (B, O) -> chunks (B, h, A), and clear (B,): no other candidate came close."""
    head, x = HEADS[architecture], (observation - mean) * scale
    if not isinstance(config, best_of_n.Config):
        return head.chunk(params, config, x, noise, images), jnp.ones(len(x), bool)
    proposed = best_of_n.candidates(params, config, x, noise, images)
    score = best_of_n.scores(best_of_n.stacked(params["critic"]), config.critic, x, proposed)
    two = jax.lax.top_k(score, min(2, score.shape[1]))[0]
    clear = two[:, 0] - two[:, -1] > CLEAR * jnp.abs(two).max(axis=1)
    return best_of_n.choose(score, proposed), clear | (score.shape[1] == 1)


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

    observation: raw, N >= 8; drawn within 3 standard deviations when None. A best of N keeps only examples with a
    clear winner, so that rounding can't choose another; noise and images are drawn anew until there is one.
    Raises PolicyFileError when its critic hardly tells the candidates apart.
    """
    if observation is None:
        drawn = generator.normal(size=(EXAMPLES, len(mean))).clip(-RANGE, RANGE)
        observation = (mean + drawn / scale).astype(np.float32)
    n = len(observation)
    noise_size = HEADS[architecture].noise_size(config, n_axes)
    shapes = {f"image.{camera.name}": (n, camera.height, camera.width, 3) for camera in cameras(config)}

    examples: dict[str, Any] = {}
    is_kept = np.zeros(n, bool)
    for _ in range(ATTEMPTS):
        fresh: dict[str, Any] = {"observation": observation}
        if noise_size > 0:
            fresh["noise"] = generator.standard_normal((n, noise_size), np.float32)
        fresh |= {name: generator.integers(0, 256, shape, np.uint8) for name, shape in shapes.items()}
        noise = fresh.get("noise", np.zeros((n, 0), np.float32))
        images = {name.removeprefix("image."): fresh[name] for name in shapes}
        chunk, clear = policy_chunk(architecture, config, params, mean, scale, observation, noise, images)
        fresh["chunk"] = np.asarray(chunk)
        examples = examples or fresh
        take = np.asarray(clear) & ~is_kept
        for name, array in fresh.items():
            examples[name] = np.where(take.reshape(-1, *[1] * (array.ndim - 1)), array, examples[name])
        is_kept |= take
        if is_kept.all() or not (noise_size or shapes):
            break
    if is_kept.sum() < EXAMPLES:
        raise PolicyFileError(
            f"Only {is_kept.sum()} of {n} golden examples have a clear winner; a policy file needs {EXAMPLES}. "
            f"The critic's scores of different candidates must lie more than {CLEAR:g} of themselves apart."
        )
    return {name: array[is_kept] for name, array in examples.items()}
