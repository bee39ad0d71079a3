"""A LeRobotDataset v3.0: policy steps as frames, at the policy rate.

    meta/info.json  meta/stats.json  meta/tasks.parquet  meta/episodes/chunk-000/file-000.parquet
    data/chunk-000/file-000.parquet    meta/tandem.json (ours: the scenario, and where the data are from)

`action` is what the arm was really told, as the learner sees it. Policies of LeRobot take every key that begins with
"action" for an output, so what was asked for lies under `complementary_info.`, as the extras of LeRobot's HIL-SERL do.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tandem.export.source import Source, whole_or_not_at_all
from tandem.learner.episode import ACTION_AXES, Episode

CODEBASE_VERSION = "v3.0"
FILES_PER_CHUNK = 1000
FILE_MB = 100
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"

Columns = dict[str, np.ndarray]  # by feature: (T,) or (T, n)


class Feature(NamedTuple):
    dtype: str
    names: list[str] | None = None  # of the numbers of a vector

    def describe(self) -> dict[str, Any]:
        return {"dtype": self.dtype, "shape": [len(self.names or [0])], "names": self.names}

    def arrow_type(self) -> pa.DataType:
        one = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}[self.dtype]
        return one if self.names is None else pa.list_(one, len(self.names))


def features(observation: list[str]) -> dict[str, Feature]:
    axes = list(ACTION_AXES)
    return {
        "observation.state": Feature("float32", observation),
        "action": Feature("float32", axes),
        "next.observation.state": Feature("float32", observation),
        "next.reward": Feature("float32"),
        "next.done": Feature("bool"),
        "next.truncated": Feature("bool"),
        "next.success": Feature("bool"),
        "complementary_info.is_intervention": Feature("bool"),
        "complementary_info.human_authority": Feature("float32"),
        "complementary_info.policy_action": Feature("float32", axes),
        "complementary_info.human_action": Feature("float32", axes),
        "complementary_info.policy_version": Feature("int64"),
        "complementary_info.discounted_return": Feature("float32"),
        "complementary_info.force_peak": Feature("float32"),
        "timestamp": Feature("float32"),
        "frame_index": Feature("int64"),
        "episode_index": Feature("int64"),
        "index": Feature("int64"),
        "task_index": Feature("int64"),
    }


def columns(episode: Episode, episode_index: int, first_frame: int, rate_hz: int) -> Columns:
    """The frames of an episode, one array a feature."""
    frame = np.arange(episode.n_steps)
    return {
        "observation.state": episode.observation,
        "action": episode.executed_action,
        "next.observation.state": episode.next_observation,
        "next.reward": episode.reward,
        "next.done": frame == episode.n_steps - 1,
        "next.truncated": episode.truncated,
        "next.success": episode.terminated & (episode.outcome == "success"),
        "complementary_info.is_intervention": episode.intervention,
        "complementary_info.human_authority": episode.alpha,
        "complementary_info.policy_action": episode.policy_action,
        "complementary_info.human_action": episode.human_action,
        "complementary_info.policy_version": episode.policy_version,
        "complementary_info.discounted_return": episode.discounted_return,
        "complementary_info.force_peak": episode.force_peak,
        "timestamp": (frame / rate_hz).astype(np.float32),
        "frame_index": frame,
        "episode_index": np.full(episode.n_steps, episode_index),
        "index": first_frame + frame,
        "task_index": np.zeros(episode.n_steps, np.int64),
    }


def write(source: Source, path: Path, instruction: str = "") -> dict[str, int]:
    """instruction: what the task is in words, for policies that read; default: the task's name."""
    instruction = instruction or str(source.scenario["task"]["name"])
    described = features(source.observation_names)
    with whole_or_not_at_all(path) as folder:
        (folder / EPISODES_PATH).parent.mkdir(parents=True)
        data = _DataFiles(folder, described)
        rows: list[dict[str, Any]] = []
        parts: list[Columns] = []
        n_frames = 0
        for index, episode in enumerate(source.episodes()):
            part = columns(episode, index, n_frames, source.policy_rate_hz)
            chunk, file = data.add(part)
            rows.append(_episode_row(episode, index, n_frames, chunk, file, instruction, part))
            parts.append(part)
            n_frames += episode.n_steps
        data.close()
        pq.write_table(pa.Table.from_pylist(rows), folder / EPISODES_PATH)
        _write_tasks(folder, [instruction])
        whole = {name: np.concatenate([part[name] for part in parts]) for name in described}
        _write_json(folder / "meta/stats.json", {name: statistics(array) for name, array in whole.items()})
        info = _info(described, len(rows), n_frames, source.policy_rate_hz)
        _write_json(folder / "meta/info.json", info)
        _write_json(folder / "meta/tandem.json", _origin(source))
    return {"episodes": len(rows), "frames": n_frames}


class _DataFiles:
    """data/: episodes one after the other, the next file when one is full."""

    def __init__(self, folder: Path, described: dict[str, Feature]) -> None:
        self._folder = folder
        self._features = described
        self._schema = pa.schema([(name, feature.arrow_type()) for name, feature in described.items()])
        self._file = -1
        self._bytes = 0
        self._writer: pq.ParquetWriter | None = None

    def add(self, part: Columns) -> tuple[int, int]:
        """Returns the indices of the chunk and of the file that the episode went to."""
        table = pa.table(
            [_arrow(part[name], self._schema.field(name).type) for name in self._features], self._schema
        )
        if self._writer is None or self._bytes + table.nbytes > FILE_MB << 20:
            self.close()
            self._file += 1
            path = self._folder / DATA_PATH.format(**self._place())
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema)
            self._bytes = 0
        self._writer.write_table(table)
        self._bytes += table.nbytes
        return self._file // FILES_PER_CHUNK, self._file % FILES_PER_CHUNK

    def _place(self) -> dict[str, int]:
        return {"chunk_index": self._file // FILES_PER_CHUNK, "file_index": self._file % FILES_PER_CHUNK}

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()


def _arrow(array: np.ndarray, kind: pa.DataType) -> pa.Array:
    if array.ndim == 1:
        return pa.array(array, kind)
    return pa.FixedSizeListArray.from_arrays(pa.array(array.reshape(-1), kind.value_type), kind.list_size)


def statistics(array: np.ndarray) -> dict[str, list[float]]:
    """Of a feature over its frames (T,) or (T, n), in the shape of one frame."""
    values = array.reshape(len(array), -1).astype(np.float64)
    figures = {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
    }
    figures |= dict(zip(QUANTILES, np.quantile(values, list(QUANTILES.values()), axis=0), strict=True))
    return {name: value.tolist() for name, value in figures.items()} | {"count": [len(values)]}


def _episode_row(
    episode: Episode, index: int, first_frame: int, chunk: int, file: int, instruction: str, part: Columns
) -> dict[str, Any]:
    end = episode.end
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": [instruction],
        "length": episode.n_steps,
        "data/chunk_index": chunk,
        "data/file_index": file,
        "dataset_from_index": first_frame,
        "dataset_to_index": first_frame + episode.n_steps,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        "tandem/episode": episode.number,
        "tandem/phase": episode.phase,
        "tandem/outcome": episode.outcome,
        "tandem/episode_seed": end.episode_seed,
        "tandem/n_takeovers": end.n_takeovers,
        "tandem/env_steps_total": end.env_steps_total,
        "tandem/policy_version": end.policy_version,
    }
    for name, array in part.items():
        row |= {f"stats/{name}/{figure}": value for figure, value in statistics(array).items()}
    return row


def _write_tasks(folder: Path, tasks: list[str]) -> None:
    """A table that pandas reads with the sentences as its index, which is where LeRobot looks for them."""
    index = "__index_level_0__"
    kinds = {"task_index": ("int64", "int64"), index: ("unicode", "object")}
    pandas = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            {
                "name": None if name == index else name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": dtype,
                "metadata": None,
            }
            for name, (kind, dtype) in kinds.items()
        ],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: tasks})
    pq.write_table(
        table.replace_schema_metadata({"pandas": json.dumps(pandas)}), folder / "meta/tasks.parquet"
    )


def _info(described: dict[str, Feature], n_episodes: int, n_frames: int, rate_hz: int) -> dict[str, Any]:
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": "panda",
        "total_episodes": n_episodes,
        "total_frames": n_frames,
        "total_tasks": 1,
        "chunks_size": FILES_PER_CHUNK,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": 200,
        "fps": rate_hz,
        "splits": {"train": f"0:{n_episodes}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": {name: feature.describe() for name, feature in described.items()},
    }


def _origin(source: Source) -> dict[str, Any]:
    return {
        "scenario": source.scenario,
        "git_revision": source.made_from.git_revision,
        "log": source.log.name,
        "episodes": list(source.ends),
    }


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
