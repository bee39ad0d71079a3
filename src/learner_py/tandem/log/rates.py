"""How regularly each channel of a log came: `./tandem log stats`.

Times are those of the messages (`utime`), so a log of a lockstep run is measured in simulated time. Intervals are taken
within an episode; what lies between two episodes is no gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tandem.log.event_log import EventLog

GAP = 1.5  # periods without a message


@dataclass(frozen=True)
class Rate:
    """One channel. None: not known, or it makes no sense for this channel."""

    events: int
    bytes: int
    undecodable: int
    hz: float | None  # within episodes
    expected_hz: float | None  # by the scenario
    jitter_ms: (
        dict[str, float] | None
    )  # p50, p99, max of |interval - period|; the period is the median when not known
    gaps: int | None  # intervals of more than GAP expected periods
    missing: int | None  # messages that the gaps have room for
    longest_gap_ms: float | None
    bytes_per_s: float | None  # over the time that the episodes took


def expected_hz(scenario: dict[str, Any]) -> dict[str, float]:
    """channel -> messages a second, of those that come regularly."""
    run, task = scenario.get("run", {}), scenario.get("task", {})
    policy_hz, state_hz = float(task.get("policy_rate_hz", 0)), int(run.get("robot_state_hz", 0))
    found = {"WORLD_STATE": policy_hz, "EPISODE_STEP": policy_hz}
    if run.get("clock") == "lockstep":
        found["TELEOP_COMMAND"] = policy_hz
    else:
        found["CONTROL_TICK"] = 1000.0
    if state_hz > 0:
        found["ROBOT_STATE"] = 1000.0 / max(1, 1000 // state_hz)  # every so many whole ticks
    return {channel: hz for channel, hz in found.items() if hz > 0}


def robot_time_s(log: EventLog) -> float:
    """Time that the episodes in a log took; that between the first and the last event when none ended."""
    hz = log.scenario.get("task", {}).get("policy_rate_hz")
    if hz and len(log.episodes):
        return float(log.episodes.n_steps.sum() / hz)
    times = log.index.timestamp
    return float(times.max() - times.min()) / 1e6 if len(times) else 0.0


def rates(log: EventLog) -> dict[str, Rate]:
    """Of every channel in a log, by name."""
    expected, seconds = expected_hz(log.scenario), robot_time_s(log)
    return {name: _rate(log, name, expected.get(name), seconds) for name in sorted(log.index.channels)}


def _rate(log: EventLog, channel: str, expected: float | None, seconds: float) -> Rate:
    rows = log.index.rows(channel)
    size = int(log.index.size[rows].sum(dtype=np.int64))
    readable = log.index.readable[rows] != 0
    if readable.any():
        rows = rows[readable]
    interval = np.diff(log.index.utime[rows])
    across = np.searchsorted(rows, log.episodes.last, side="right") - 1  # from one episode to the next
    interval[across[(across >= 0) & (across < len(interval))]] = 0
    interval = interval[interval > 0] / 1e6  # a message that was sent again is no interval
    hz = jitter = gaps = missing = longest = None
    if len(interval):
        hz = float(len(interval) / interval.sum())
        period = 1.0 / expected if expected else float(np.median(interval))
        off = 1e3 * np.abs(interval - period)
        p50, p99 = np.percentile(off, [50, 99])
        jitter = {"p50": float(p50), "p99": float(p99), "max": float(off.max())}
    if expected:
        long = interval[interval > GAP / expected]
        gaps, missing = len(long), int(np.round(long * expected - 1).sum())
        longest = float(1e3 * long.max(initial=0.0))
    return Rate(
        events=len(readable),
        bytes=size,
        undecodable=int((~readable).sum()),
        hz=hz,
        expected_hz=expected,
        jitter_ms=jitter,
        gaps=gaps,
        missing=missing,
        longest_gap_ms=longest,
        bytes_per_s=size / seconds if seconds > 0 else None,
    )
