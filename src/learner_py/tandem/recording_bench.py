"""What `tandem bench recording` runs: a training in real time at full rate, recorded by its own log and by lcm-logger.

Full rate: ROBOT_STATE at 1 kHz on the wire, CONTROL_TICK at 1 kHz in the log. Afterwards every message that carries a
number is counted: the in-process log must have no hole, and lcm-logger all that the log has of what went over the wire.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.learner_status_t import learner_status_t

from tandem import processes
from tandem.processes import Child
from tandem.run_folder import ROOT, RunFolder, raw_events
from tandem.spy import once
from tandem.spy.layout import Layout, of_fingerprint
from tandem.spy.model import Model
from tandem.spy.recording import Recording
from tandem.wire import CHANNELS, Wire

ROBOT_STATE_HZ = 1000
DEMONSTRATIONS = 3
ON_THE_WIRE = ("ROBOT_STATE", "WORLD_STATE", "ACTION_CHUNK", "EPISODE_STEP", "EPISODE_END")
START_LIMIT_S = 300.0  # demonstrations and the learner's start


class RecordingBenchError(Exception):
    """A sentence: what could not be measured and why."""


def lcm_logger() -> Path:
    """LCM's recorder, from the wheel."""
    found = ROOT / ".venv" / "bin" / "lcm-logger"
    if not found.exists():
        raise RecordingBenchError(f"{found} is missing; it comes with the package lcm: call ./tandem doctor.")
    return found


def record(folder: Path, task: str, minutes: float, say: Any) -> dict[str, Any]:
    """Trains and records until the learner has been at work for so long. Returns what was told meanwhile."""
    url, run = processes.free_lcm_url(), folder / "run"
    foreign = folder / "lcm-logger.lcm"
    settings = {
        "run.robot_state_hz": ROBOT_STATE_HZ,
        "run.demonstrations": DEMONSTRATIONS,
        "run.env_steps": 10_000_000,  # until it is stopped
        "run.evaluation_every": 10_000_000,
        "run.video_episodes": 0,
    }
    sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    logger = Child("lcm-logger", [lcm_logger(), f"--lcm-url={url}", foreign], folder / "lcm-logger.out")
    training: Child | None = None
    wire = Wire(url)
    told: dict[str, Any] = {"updates": 0, "status": None}
    wire.subscribe(learner_status_t, lambda status, _: told.update(updates=status.updates_done))
    wire.subscribe(controller_status_t, lambda status, _: told.update(status=status))
    try:
        time.sleep(1.0)
        command = [sys.executable, "-m", "tandem", "train", task, "--clock", "realtime", "--run", str(run)]
        training = Child("training", [*command, "--lcm-url", url, *sets], folder / "train.out")

        def wait(seconds: float, until: Any) -> None:
            deadline = time.monotonic() + seconds
            while not until() and time.monotonic() < deadline:
                for child in (training, logger):
                    if child is not None and child.poll() is not None:
                        raise RecordingBenchError(child.death())
                wire.handle(0.2)

        wait(START_LIMIT_S, lambda: told["updates"] > 0)
        if not told["updates"]:
            raise RecordingBenchError(f"the learner made no update within {START_LIMIT_S:.0f} s; see {run}.")
        say(f"The learner is at work; recording for {minutes:g} minutes ...")
        began, updates = time.monotonic(), told["updates"]
        wait(60.0 * minutes, lambda: False)
        passed = time.monotonic() - began
        updates = told["updates"] - updates
        training.send(signal.SIGINT)
        deadline = time.monotonic() + 90.0
        while training.poll() is None and time.monotonic() < deadline:
            wire.handle(0.2)
        time.sleep(1.0)
    finally:
        if training is not None:
            training.stop(30.0)
        logger.stop(10.0)
    status = told["status"]
    return {
        "log": RunFolder(run).log,
        "lcm_logger": foreign,
        "seconds": passed,
        "learner_updates": updates,
        "learner_updates_per_s": updates / passed,
        "ticks": status.ticks,
        "overruns": status.overruns,
        "records_dropped": status.records_dropped,
    }


def count(log: Path, foreign: Path) -> dict[str, Any]:
    """Messages and holes of both recordings."""
    model, recording = Model(), Recording(log)
    with contextlib.closing(recording):
        once.read(recording, model)
    rows = {row.channel: row for row in model.rows()}
    missing = event_numbers_missing(log)
    own: dict[str, Any] = {
        "bytes": log.stat().st_size,
        "messages": sum(row.count for row in rows.values()),
        "event_numbers_missing": missing,
        "channels": {name: {"count": row.count, "gaps": row.gaps} for name, row in rows.items()},
        "undecodable": sum(row.undecodable for row in rows.values()),
    }
    own["lost"] = missing + sum(row.gaps or 0 for row in rows.values())
    here, there = numbers(log), numbers(foreign)
    compared = {
        name: {
            "in_log": len(here[name]),
            "in_lcm_logger": len(there[name]),
            "lost": len(np.setdiff1d(here[name], there[name], assume_unique=True)),
        }
        for name in ON_THE_WIRE
    }
    lost = sum(value["lost"] for value in compared.values())
    return {"own": own, "lcm_logger": {"bytes": foreign.stat().st_size, "channels": compared, "lost": lost}}


def event_numbers_missing(log: Path) -> int:
    """Events number from 0 on; a hole is an event that was not written."""
    last, missing = -1, 0
    for event in raw_events(log):
        missing += max(0, event.number - last - 1)
        last = event.number
    return missing


def numbers(log: Path) -> dict[str, np.ndarray]:
    """Channel -> the numbers of its messages, the episode's with the message's own, each once."""
    found: dict[str, list[np.ndarray]] = {name: [] for name in ON_THE_WIRE}
    held: dict[str, list[bytes]] = {name: [] for name in ON_THE_WIRE}

    def take(name: str) -> None:
        message_type: Any = CHANNELS[name]
        layout = of_fingerprint(message_type._get_packed_fingerprint())
        assert layout is not None
        if held[name]:
            found[name].append(_keys(layout, held[name]))
            held[name] = []

    for event in raw_events(log, frozenset(ON_THE_WIRE)):
        held[event.channel].append(event.data)
        if len(held[event.channel]) >= 4096:
            take(event.channel)
    for name in ON_THE_WIRE:
        take(name)
    return {name: np.unique(np.concatenate([*parts, np.zeros(0, np.int64)])) for name, parts in found.items()}


def _keys(layout: Layout, data: list[bytes]) -> np.ndarray:
    sequence = layout.sequence
    assert sequence is not None
    number = layout.read(sequence.member, data)
    return number if sequence.group is None else (layout.read(sequence.group, data) << 32) + number
