"""What a policy file's critic says of an episode: Q of what was executed and of what the policy had asked.

Values are not logged: the critic that came with the policy computes them again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tandem.learner.episode import ACTION_AXES, Episode, Floats
from tandem.log.event_log import EventLog
from tandem.log.events import Array
from tandem.run_folder import RunFolder


@dataclass(frozen=True)
class Values:
    """Of one episode, a row a step; NaN where there was no chunk of the policy's."""

    policy: Path  # whose critic it is
    version: int
    executed: Floats  # (T,) Q of what the arm did in the h steps from here; the human's where he was engaged
    asked: Floats  # (T,) Q of the chunk that the policy had asked for here


def policy_of(log: EventLog, episode: Episode) -> Path | None:
    """The policy file in force in this episode; when it is gone, the latest checkpoint from before it, else None."""
    announced = log.columns("POLICY_ANNOUNCE", "version", "path")
    folder = RunFolder(log.path.parent)
    for version, path in zip(announced["version"].tolist(), announced["path"].tolist(), strict=True):
        if version == episode.end.policy_version and (log.path.parent / path).is_file():
            return log.path.parent / path
    before = episode.end.env_steps_total - (episode.n_steps if episode.is_training else 0)
    earlier = [file for steps, file in folder.checkpoints().items() if steps <= before]
    return earlier[-1] if earlier else None


def values(policy: Path, episode: Episode, chunk_step: Array, chunk: Array) -> Values | None:
    """None when the file carries no critic.

    chunk_step (N,): steps of the episode; chunk (N, h, 7): what the policy asked for from there on.
    """
    import jax.numpy as jnp

    from tandem.images import decode_all
    from tandem.learner.networks import best_of_n, encoded, read_config
    from tandem.learner.windows import executed_chunks
    from tandem.policy_file import network, read_header, read_safetensors

    header, (tensors, _) = read_header(policy), read_safetensors(policy)
    if header.architecture not in ("best_of_n", "encoded"):
        return None
    config, params = read_config(header.architecture, header.config), network(tensors, header.architecture)
    x = (episode.observation - tensors["normalizer.mean"]) * tensors["normalizer.scale"]
    if isinstance(config, encoded.Config):
        if not episode.images:
            return None  # recorded without the camera
        encoder, params = encoded.parts(params, config)
        images = {config.cameras[0].name: jnp.asarray(decode_all(episode.images[:-1]))}
        x = np.asarray(encoded.encode(encoder, config, jnp.asarray(x), images))
        config = config.head.config
    if not isinstance(config, best_of_n.Config):
        return None
    critic = best_of_n.stacked(params["critic"])
    columns = [ACTION_AXES.index(axis) for axis in header.action]
    executed, _ = executed_chunks(episode, columns, config.horizon)

    def q(rows: Array, chunks: Array) -> Floats:
        scored = best_of_n.scores(critic, config.critic, jnp.asarray(x[rows]), jnp.asarray(chunks[:, None]))
        return np.asarray(scored)[:, 0]

    asked = np.full(episode.n_steps, np.nan, np.float32)
    known = (chunk_step >= 0) & (chunk_step < episode.n_steps)
    if known.any() and chunk.shape[1] == config.horizon:
        rows = chunk_step[known]
        asked[rows] = q(rows, chunk[known][:, :, columns].astype(np.float32))
    return Values(policy, header.version, q(np.arange(episode.n_steps), executed), asked)
