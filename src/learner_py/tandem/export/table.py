"""Tables for pandas, R, a spreadsheet or PlotJuggler, as CSV or Parquet.

Without a channel: one row a policy step, with the facts of its episode beside it. With a channel: one row a message.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from tandem.export.message import JSON_TYPES
from tandem.export.source import Source, whole_or_not_at_all
from tandem.learner.episode import ACTION_AXES, Episode
from tandem.log.fields import as_json
from tandem.run_folder import RunFolderError
from tandem.wire import CHANNELS, members


def write(source: Source, path: Path, kind: str, channel: str = "") -> dict[str, int]:
    """kind: csv or parquet."""
    table = channel_table(source, channel) if channel else steps_table(source)
    with whole_or_not_at_all(path) as partial:
        if kind == "csv":
            pa.csv.write_csv(table, partial)
        else:
            pq.write_table(table, partial)
    return {"episodes": len(source.ends), "rows": table.num_rows, "columns": table.num_columns}


# ---- policy steps


def steps_table(source: Source) -> pa.Table:
    return pa.concat_tables(
        [pa.table(_steps(episode, source)) for episode in source.episodes()],
    )


def _steps(episode: Episode, source: Source) -> dict[str, Any]:
    n = episode.n_steps

    def vector(prefix: str, names: list[str] | tuple[str, ...], array: np.ndarray) -> dict[str, np.ndarray]:
        return {f"{prefix}.{name}": array[:, column] for column, name in enumerate(names)}

    observation = source.observation_names
    return {
        "episode": np.full(n, episode.number),
        "phase": [episode.phase] * n,
        "outcome": [episode.outcome] * n,
        "episode_steps": np.full(n, n),
        "env_steps_total": np.full(n, episode.end.env_steps_total),
        "step": np.arange(n),
        "time_s": np.arange(n) / source.policy_rate_hz,
        **vector("observation", observation, episode.observation),
        **vector("next_observation", observation, episode.next_observation),
        **vector("policy_action", ACTION_AXES, episode.policy_action),
        **vector("human_action", ACTION_AXES, episode.human_action),
        **vector("executed_action", ACTION_AXES, episode.executed_action),
        "alpha": episode.alpha,
        "intervention": episode.intervention,
        "terminated": episode.terminated,
        "truncated": episode.truncated,
        "reward": episode.reward,
        "discounted_return": episode.discounted_return,
        "policy_version": episode.policy_version,
        "chunk_id": episode.chunk_id,
        "chunk_index": episode.chunk_index,
        "force_peak": episode.force_peak,
    }


# ---- messages of a channel


def channel_table(source: Source, channel: str) -> pa.Table:
    """Arrays of fixed size are spread over columns NAME.0, NAME.1 ...; others are JSON."""
    if channel not in CHANNELS:
        raise RunFolderError(f"--channel is {channel}; it must be one of {', '.join(CHANNELS)}.")
    rows = [(event.timestamp, event.message) for event in source.messages(channel)]
    if not rows:
        raise RunFolderError(f"{source.log} holds no {channel} of these episodes.")
    table: dict[str, Any] = {"log_time_us": [timestamp for timestamp, _ in rows]}
    for name, kind, dimensions in members(CHANNELS[channel]):
        values = [getattr(message, name) for _, message in rows]
        shape = [size for size in dimensions if isinstance(size, int)]
        if kind in JSON_TYPES and not dimensions:
            table[name] = values
        elif kind in JSON_TYPES and len(shape) == len(dimensions):
            spread = np.array(values).reshape(len(rows), -1)
            for column, index in enumerate(np.ndindex(*shape)):
                table[".".join([name, *map(str, index)])] = spread[:, column]
        else:
            table[name] = [as_json(value).decode() for value in values]
    return pa.table(table)
