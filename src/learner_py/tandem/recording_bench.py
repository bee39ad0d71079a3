"""What `tandem bench recording` runs: a training in real time at full rate, recorded by its own log and by lcm-logger.

Full rate: CONTROL_TICK and ROBOT_STATE at 1 kHz in the log. Over the wire the controller sends ROBOT_STATE less often
(the latest, see link.cpp), so that another program publishes two numbered channels at 1 kHz beside it. Afterwards
every message that carries a number is counted: the in-process log must have no hole; lcm-logger must have all that the
log has of what goes over the wire whole, and all that the other program sent.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tandem_lcm.tandem.controller_status_t import controller_status_t
from tandem_lcm.tandem.learner_status_t import learner_status_t

from tandem import processes
from tandem.log import raw_events
from tandem.processes import Child
from tandem.run_folder import ROOT, RunFolder
from tandem.spy import once
from tandem.spy.bench import BENCH_PREFIX, Load, program
from tandem.spy.layout import Layout, of_fingerprint
from tandem.spy.model import Model
from tandem.spy.recording import Recording
from tandem.wire import CHANNELS, Wire

ROBOT_STATE_HZ = 1000
DEMONSTRATIONS = 3
ON_THE_WIRE = (
    "WORLD_STATE",
    "ACTION_CHUNK",
    "EPISODE_STEP",
    "EPISODE_END",
)  # every one of them, when it lies in the log
START_LIMIT_S = 300.0  # demonstrations and warm start
WIRE_CHANNELS, WIRE_HZ = 2, 1000
EPISODE_BITS = 32  # the episode lies above so many bits of a number


class RecordingBenchError(Exception):
    """A sentence: what could not be measured and why."""


def lcm_logger() -> Path:
    """LCM's recorder, from the wheel."""
    found = ROOT / ".venv" / "bin" / "lcm-logger"
    if not found.exists():
        raise RecordingBenchError(f"{found} is missing; it comes with the package lcm: call ./tandem doctor.")
    return found


def may_have_priority() -> bool:
    """Whether SCHED_FIFO is allowed."""
    return subprocess.run(["chrt", "--fifo", "1", "true"], capture_output=True).returncode == 0


def record(folder: Path, task: str, minutes: float, say: Any) -> dict[str, Any]:
    """Trains and records until the learner has been at work for so long. Returns what was told meanwhile."""
    url, run = processes.free_lcm_url(), folder / "run"
    settings = {
        "run.robot_state_hz": ROBOT_STATE_HZ,
        "run.demonstrations": DEMONSTRATIONS,
        "run.env_steps": 10_000_000,  # until it is stopped
        "run.learner_lag": 10,  # a slow machine's arm shall not wait for the learner
        "method.learner.warm_start_updates": 200,
        "run.evaluation_every": 10_000_000,
        "run.video_episodes": 0,
    }
    sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    # its queue holds 30 messages: where it has to wait for the processor it loses some, so that it runs twice
    plain: processes.Command = [lcm_logger(), f"--lcm-url={url}"]
    commands = {"lcm-logger": plain, "lcm-logger, real-time priority": ["chrt", "--fifo", "1", *plain]}
    if not may_have_priority():
        del commands["lcm-logger, real-time priority"]
    files = {name: folder / f"logger-{i}.lcm" for i, name in enumerate(commands)}
    loggers = [
        Child(name, [*command, files[name]], files[name].with_suffix(".out"))
        for name, command in commands.items()
    ]
    training: Child | None = None
    generator: Child | None = None
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
                for child in (training, *loggers):
                    if child is not None and child.poll() is not None:
                        raise RecordingBenchError(child.death())
                wire.handle(0.2)

        def training_goes_on() -> bool:
            return told["updates"] > 0 and told["status"] is not None and told["status"].env_steps_total > 0

        wait(START_LIMIT_S, training_goes_on)
        if not training_goes_on():
            raise RecordingBenchError(f"no training step was made within {START_LIMIT_S:.0f} s.")
        say(f"The training goes on; recording for {minutes:g} minutes ...")
        load = Load(WIRE_CHANNELS, WIRE_HZ, 60.0 * minutes)
        generator = program("generator", folder, "generate", url, load.channels, load.hz, load.seconds)
        began, updates = time.monotonic(), told["updates"]
        wait(60.0 * minutes, lambda: False)
        passed = time.monotonic() - began
        updates = told["updates"] - updates
        if generator.wait(30.0) != 0:
            raise RecordingBenchError(generator.death())
        training.send(signal.SIGINT)
        deadline = time.monotonic() + 90.0
        while training.poll() is None and time.monotonic() < deadline:
            wire.handle(0.2)
        time.sleep(1.0)
    finally:
        if generator is not None:
            generator.stop(1.0)
        if training is not None:
            training.stop(30.0)
        for logger in loggers:
            logger.stop(10.0)
    status = told["status"]
    return {
        "log": RunFolder(run).log,
        "others": files,
        "sent_beside": load.messages,
        "seconds": passed,
        "learner_updates": updates,
        "learner_updates_per_s": updates / passed,
        "ticks": status.ticks,
        "overruns": status.overruns,
        "records_dropped": status.records_dropped,
    }


def count(log: Path, others: Mapping[str, Path], sent_beside: int) -> dict[str, Any]:
    """Messages and holes of all recordings; sent_beside: messages that were published beside the run."""
    model, recording = Model(), Recording(log)
    with contextlib.closing(recording):
        once.read(recording, model)
    rows = {row.channel: row for row in model.rows()}
    missing = event_numbers_missing(log)
    own = {
        "bytes": log.stat().st_size,
        "messages": sum(row.count for row in rows.values()),
        "event_numbers_missing": missing,
        "channels": {name: {"count": row.count, "gaps": row.gaps} for name, row in rows.items()},
        "undecodable": sum(row.undecodable for row in rows.values()),
        "lost": missing + sum(row.gaps or 0 for row in rows.values()),
    }
    sent = _sent(numbers(log))
    compared = {}
    for name, file in others.items():
        there = numbers(file)
        channels = {
            channel: _compared(len(keys), len(np.intersect1d(keys, there[channel], assume_unique=True)))
            for channel, keys in sent.items()
        }
        channels["beside, 1 kHz"] = _compared(sent_beside, _count_beside(file))
        lost = sum(value["lost"] for value in channels.values())
        compared[name] = {"bytes": file.stat().st_size, "channels": channels, "lost": lost}
    return {"own": own, "others": compared}


def _compared(sent: int, recorded: int) -> dict[str, int]:
    return {"sent": sent, "recorded": recorded, "lost": sent - recorded}


def _sent(logged: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What went over the wire of what was logged: not an episode's last state, for which nobody waits any more, and
    not the steps of the last episode, which the end of the run cut off."""
    states = logged["WORLD_STATE"]
    followed = np.diff(states >> EPISODE_BITS, append=-1) == 0
    last = int(states[-1] >> EPISODE_BITS) if len(states) else 0
    steps, ends = logged["EPISODE_STEP"], logged["EPISODE_END"]
    return logged | {
        "WORLD_STATE": states[followed],
        "EPISODE_STEP": steps[steps >> EPISODE_BITS < last],
        "EPISODE_END": ends[ends < last],
    }


def _count_beside(foreign: Path) -> int:
    """Messages of the other program, each number once."""
    seen: dict[str, set[bytes]] = {}
    for event in raw_events(foreign):
        if event.channel.startswith(BENCH_PREFIX):
            layout = of_fingerprint(event.data[:8])
            assert layout is not None and layout.sequence is not None
            offset, _ = layout.members[layout.sequence.member]
            seen.setdefault(event.channel, set()).add(event.data[offset : offset + 8])
    return sum(len(numbers) for numbers in seen.values())


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
    return number if sequence.group is None else (layout.read(sequence.group, data) << EPISODE_BITS) + number
