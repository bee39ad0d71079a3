"""What a log holds, in figures: `./tandem log info`."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np

from tandem.faults import fault_text
from tandem.log.event_log import EventLog
from tandem.log.files import missing
from tandem.log.rates import rates, robot_time_s
from tandem.statistics import share
from tandem.wire import CHANNELS
from tandem.words import OUTCOMES, PHASES

_END = (
    *("episode", "phase", "outcome", "fault", "n_steps", "n_intervention_steps", "n_takeovers"),
    *("force_peak", "policy_version"),
)


def describe(log: EventLog) -> dict[str, Any]:
    """Scenario, episodes by phase, policies, channels with their rates, and what is wrong with it."""
    index = log.index
    starts = log.starts
    run = log.scenario.get("run", {})
    scenario = None
    if starts:
        scenario = {key: run.get(key) for key in ("task", "method", "seed", "mode", "clock")}
        scenario["git_revision"] = starts[0].git_revision
    ends = log.columns("EPISODE_END", *_END, rows=log.episodes.last)
    return {
        "file": str(log.path),
        "files": len(index.files),
        "bytes": index.n_bytes,
        "events": len(index),
        "robot_time_s": robot_time_s(log),
        "scenario": scenario,
        "resumed_at": [start.first_episode for start in starts if start.first_episode],
        "episodes": len(ends["row"]),
        "phases": {
            name: _phase(ends, phase) for phase, name in PHASES.items() if (ends["phase"] == phase).any()
        },
        "policies": _policies(log, ends),
        "channels": {name: asdict(rate) for name, rate in rates(log).items()},
        "health": _health(log, ends),
        "cut_off_bytes": index.cut_off_bytes,
    }


def _phase(ends: dict[str, np.ndarray], phase: int) -> dict[str, Any]:
    of = {name: column[ends["phase"] == phase] for name, column in ends.items()}
    steps = int(of["n_steps"].sum())
    return {
        "episodes": len(of["row"]),
        "steps": steps,
        "outcomes": dict(Counter(OUTCOMES.get(outcome, "?") for outcome in of["outcome"].tolist())),
        "human_share": share(int(of["n_intervention_steps"].sum()), steps),
        "takeovers": int(of["n_takeovers"].sum()),
        "force_peak_max": float(of["force_peak"].max()),
    }


def _policies(log: EventLog, ends: dict[str, np.ndarray]) -> dict[str, Any] | None:
    """Versions that came into force, and how far the last of them had learnt."""
    announced = log.columns("POLICY_ANNOUNCE", "version", "updates", "episodes_trained_through")
    if not len(announced["row"]):
        return None
    return {
        "versions": len(np.unique(announced["version"])),
        "first": int(announced["version"][0]),
        "last": int(announced["version"][-1]),
        "last_updates": int(announced["updates"][-1]),
        "last_trained_through": int(announced["episodes_trained_through"][-1]),
        "last_that_ended_an_episode": int(ends["policy_version"][-1]) if len(ends["row"]) else None,
    }


def _health(log: EventLog, ends: dict[str, np.ndarray]) -> dict[str, Any]:
    """What can be told without reading every message; `./tandem log check` reads them."""
    index = log.index
    known = np.array([name in CHANNELS for name in index.channels] or [False])
    undecodable = int(((index.readable == 0) & known[index.channel]).sum()) if len(index) else 0
    status = log.columns("CONTROLLER_STATUS", "overruns", "records_dropped")
    numbers = ends["episode"]
    return {
        "files_missing": missing(log.path),
        "damaged_regions": len(index.damage),
        "damaged_bytes": index.damaged_bytes,
        "undecodable": undecodable,
        "faults": {fault_text(f): n for f, n in sorted(Counter(ends["fault"].tolist()).items()) if f},
        "overruns": int(status["overruns"].max(initial=0)),
        "records_dropped": int(status["records_dropped"].max(initial=0)),
        "episodes_missing": int((np.diff(numbers) - 1).clip(0).sum()),
        "episodes_without_motion": _without_motion(log),
    }


def _without_motion(log: EventLog) -> int:
    """Episodes of which only what is learnt from was recorded, in a log that has others."""
    shown = log.index.rows("WORLD_STATE")
    if not len(shown):
        return 0
    of = log.episodes
    n_shown = np.searchsorted(shown, of.last, side="right") - np.searchsorted(shown, of.first)
    return int(((n_shown == 0) & (of.n_steps > 0)).sum())
