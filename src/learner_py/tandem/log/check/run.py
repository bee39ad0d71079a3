"""What a log tells of its run, as far as checks need it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tandem.learner.episode import ACTION_AXES
from tandem.log.event_log import EventLog
from tandem.log.events import Array


@dataclass
class Run:
    log: EventLog
    lockstep: bool
    ticks_per_step: int
    discount: float | None
    masked: Array  # (6,) axes that the task does not move
    workspace: tuple[Array, Array] | None  # m, low and high


def run_of(log: EventLog) -> Run:
    task, method = log.scenario.get("task", {}), log.scenario.get("method", {})
    axes = task.get("action_axes", ACTION_AXES)
    low, high = task.get("workspace_low_m"), task.get("workspace_high_m")
    return Run(
        log,
        lockstep=log.scenario.get("run", {}).get("clock") == "lockstep",
        ticks_per_step=round(1000 / float(task.get("policy_rate_hz", 10))),
        discount=method.get("discount"),
        masked=np.array([axis not in axes for axis in ACTION_AXES[:6]]),
        workspace=None if low is None or high is None else (np.array(low), np.array(high)),
    )
