"""A LeRobotDataset v3.0 (data/, meta/info.json) as demonstrations: frames become policy steps.

State and action are taken by name, so their order in the dataset does not matter; what the task does not know is left
out. Rewards are ours: 1 at the last frame of a success; where a dataset does not say which episodes succeeded, all did.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.dataset

from tandem.demonstrations import end_of_demonstration
from tandem.learner.episode import ACTION_AXES, Episode
from tandem.learner.windows import discounted_returns
from tandem.run_folder import RunFolderError, shown
from tandem.scenario import Scenario

STATE, ACTION, NEXT_STATE = "observation.state", "action", "next.observation.state"
SUCCESS = ("next.success", "next.reward")  # the first that a dataset has tells


class Imported(NamedTuple):
    episodes: list[Episode]  # successful ones, numbered from 0
    left_out: int  # unsuccessful ones
    tells_success: bool


def read(dataset: Path, scenario: Scenario) -> Imported:
    """Raises RunFolderError with a sentence when the dataset is not of the scenario's task."""
    info = _info(dataset)
    task = scenario.data["task"]
    rate = task["policy_rate_hz"]
    if info["fps"] != rate:
        raise RunFolderError(
            f"{shown(dataset)} has {info['fps']} frames a second, and the policy runs at {rate} Hz; record or resample"
            f" at that rate, or give --set task.policy_rate_hz={info['fps']}."
        )
    state = _columns(dataset, info, STATE, scenario.observation)
    action = _columns(dataset, info, ACTION, task["action_axes"])
    told = next((name for name in SUCCESS if name in info["features"]), None)
    episodes: list[Episode] = []
    left_out = 0
    for index, frames in _frames(
        dataset, [STATE, ACTION, *filter(info["features"].get, (NEXT_STATE, *SUCCESS))]
    ):
        if told and not np.asarray(frames[told], np.float64).max() > 0:
            left_out += 1
            continue
        executed = np.zeros((len(frames[ACTION]), len(ACTION_AXES)), np.float32)
        for axis, column in action.items():
            executed[:, ACTION_AXES.index(axis)] = frames[ACTION][:, column]
        _check(dataset, index, executed)
        columns = list(state.values())
        seen = frames[STATE][:, columns]
        after = frames[NEXT_STATE][:, columns] if NEXT_STATE in frames else np.vstack([seen[1:], seen[-1:]])
        discount = float(scenario.data["method"]["discount"])
        episodes.append(_demonstration(len(episodes), seen, after, executed, discount))
    if not episodes:
        raise RunFolderError(f"{shown(dataset)} holds no successful episode; there is nothing to learn from.")
    return Imported(episodes, left_out, told is not None)


def _info(dataset: Path) -> dict[str, Any]:
    try:
        info = json.loads((dataset / "meta/info.json").read_text(encoding="utf-8"))
        version, _ = info["codebase_version"], (info["fps"], info["features"])
    except (OSError, ValueError, KeyError, TypeError):
        raise RunFolderError(
            f"{shown(dataset)} is no LeRobotDataset: meta/info.json is missing or not readable."
        ) from None
    if not str(version).startswith("v3."):
        raise RunFolderError(
            f"{shown(dataset)} is a LeRobotDataset {version}; v3.0 is read."
            " Convert it by LeRobot's convert_dataset_v21_to_v30."
        )
    return info


def _columns(dataset: Path, info: dict[str, Any], feature: str, wanted: list[str]) -> dict[str, int]:
    """Name -> column, of the numbers that the task needs."""
    names = info["features"].get(feature, {}).get("names")
    if isinstance(names, dict):  # by group, e.g. {"motors": [...]}
        names = [name for group in names.values() for name in group]
    missing = [name for name in wanted if name not in (names or [])]
    if missing:
        raise RunFolderError(
            f"{shown(dataset)}: {feature} does not name {', '.join(missing[:5])}{' ...' if missing[5:] else ''};"
            f" it names {', '.join(map(str, (names or ['nothing'])[:8]))}. The task needs {', '.join(wanted)}."
        )
    # axes that the task masks are wanted too when they are there: the gripper of a task that keeps it closed
    more = [name for name in names if feature == ACTION and name in ACTION_AXES]
    return {name: names.index(name) for name in dict.fromkeys([*wanted, *more])}


def _frames(dataset: Path, names: list[str]) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """(episode index, columns) of each episode, frames in order."""
    table = pa.dataset.dataset(dataset / "data", format="parquet").to_table(
        columns=["episode_index", "frame_index", *names]
    )
    table = table.sort_by([("episode_index", "ascending"), ("frame_index", "ascending")])
    index = table["episode_index"].to_numpy()
    arrays = {name: _array(table[name].combine_chunks()) for name in names}
    starts = [0, *(np.flatnonzero(np.diff(index)) + 1), len(index)]
    for start, end in pairwise(starts):
        if end > start:
            yield int(index[start]), {name: array[start:end] for name, array in arrays.items()}


def _array(column: pa.Array) -> np.ndarray:
    if pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), -1).astype(np.float32)
    return column.to_numpy(zero_copy_only=False)


def _check(dataset: Path, index: int, executed: np.ndarray) -> None:
    wrong = ~(np.abs(executed) <= 1.0)
    if wrong.any():
        frame, axis = np.argwhere(wrong)[0]
        raise RunFolderError(
            f"{shown(dataset)}: action {ACTION_AXES[axis]} of episode {index}, frame {frame} is"
            f" {executed[frame, axis]:.6g}; it must be in [-1, 1], in units of the task's limit per step."
        )


def _demonstration(
    number: int, seen: np.ndarray, after: np.ndarray, executed: np.ndarray, discount: float
) -> Episode:
    n = len(executed)
    last = np.arange(n) == n - 1
    reward = last.astype(np.float32)
    none = np.full(n, -1, np.int64)
    return Episode(
        number=number,
        end=end_of_demonstration(number, n),
        observation=seen,
        next_observation=after,
        policy_action=np.zeros_like(executed),
        human_action=executed,
        executed_action=executed,
        alpha=np.ones(n, np.float32),
        intervention=np.ones(n, bool),
        terminated=last,
        truncated=np.zeros(n, bool),
        reward=reward,
        discounted_return=discounted_returns(reward, discount).astype(np.float32),
        policy_version=np.zeros(n, np.int64),
        chunk_id=none,
        chunk_index=np.zeros(n, np.int64),
        force_peak=np.zeros(n, np.float32),
    )
