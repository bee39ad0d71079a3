"""What `tandem bench log` measures: how fast a large log is read, decoded and indexed, by us and by LCM's own readers.

The log is a real one (the scripted operator's episodes, recorded here, or one that is given) written again and again
until it is as large as asked. All sides read it from the system's cache, in turns.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lcm

from tandem import run_folder, scenario
from tandem.evaluation import Evaluation
from tandem.log import EventLog
from tandem.log.index import index_file, read_index
from tandem.log.spy_jar import lcm_program
from tandem.wire import CHANNELS, decode

DECODED_MB = 100.0  # of the log, by readers that decode one message after the other
SEED = 6_000_000


@dataclass
class Measured:
    """One reader's turn."""

    mb: float
    wall_s: float
    cpu_s: float  # user and system, of child processes too

    @property
    def mb_per_s(self) -> float:
        return self.mb / self.wall_s

    @property
    def mb_per_cpu_s(self) -> float:
        return self.mb / max(self.cpu_s, 1e-9)


def record(folder: Path, episodes: int = 20) -> Path:
    """A log of demonstrations with ROBOT_STATE at 100 Hz. Raises EvaluationError with a sentence."""
    composed = scenario.compose(run_folder.CONFIG, "peg", "tandem", {})
    run = folder / "recorded"
    Evaluation("recording", composed, None, SEED, episodes, run, robot_state_hz=100).run()
    return run / "log.lcm"


def repeat(log: Path, out: Path, mb: float) -> int:
    """Writes whole copies of a log until the file has so many MB. Returns how many."""
    content = log.read_bytes()
    copies = max(1, round(mb * 1e6 / len(content)))
    with out.open("wb") as file:
        for _ in range(copies):
            file.write(content)
    return copies


def measure(work: Callable[[], float]) -> Measured:
    """work: does it and returns MB."""
    before, began = os.times(), time.perf_counter()
    mb = work()
    wall, after = time.perf_counter() - began, os.times()
    cpu = sum(after[:4]) - sum(before[:4])
    return Measured(mb, wall, cpu)


def readers(log: Path) -> dict[str, Callable[[], float]]:
    """What is measured, by name; a pair of names of ours and of the peers' shares its first word."""
    size = log.stat().st_size / 1e6

    def index() -> float:
        index_file(log).unlink(missing_ok=True)
        read_index(log)
        return size

    def read() -> float:
        for _ in EventLog(log, keep_index=True).events():
            pass
        return size

    def decode_columns() -> float:
        opened = EventLog(log, keep_index=True)
        for channel in opened.index.channels:
            for _ in opened.column_blocks(channel, *CHANNELS[channel].__slots__):  # type: ignore[attr-defined]
                pass
        return size

    def read_lcm() -> float:
        for _ in lcm.EventLog(str(log), "r"):
            pass
        return size

    def decode_lcm() -> float:
        done = 0
        for event in lcm.EventLog(str(log), "r"):
            decode(event.channel, event.data)
            done += 28 + len(event.channel) + len(event.data)
            if done > 1e6 * DECODED_MB:
                break
        return done / 1e6

    def copy_logfilter() -> float:
        command = [str(lcm_program("lcm-logfilter")), "-c", ".*", str(log), "/dev/null"]
        subprocess.run(command, check=True, capture_output=True)
        return size

    return {
        "index: tandem, from nothing": index,
        "read: tandem, every event": read,
        "read: lcm.EventLog in Python": read_lcm,
        "read: lcm-logfilter to /dev/null": copy_logfilter,
        "decode: tandem, every field as arrays": decode_columns,
        "decode: lcm.EventLog and lcm-gen's Python": decode_lcm,
    }


def start_up(log: Path) -> Measured:
    """`tandem log info`, from the call to its end, with the index that is there."""

    def work() -> float:
        command = [sys.executable, "-m", "tandem", "log", "info", str(log)]
        subprocess.run(command, check=True, capture_output=True)
        return log.stat().st_size / 1e6

    return measure(work)


def report(rounds: list[dict[str, Measured]], log: Path, copies: int) -> dict[str, Any]:
    """Medians of the rounds, under the names that other tools read."""
    rows = []
    for name in rounds[0]:
        turns = [turn[name] for turn in rounds]
        rows.append(
            {
                "reader": name,
                "mb": turns[0].mb,
                "mb_per_s": statistics.median(turn.mb_per_s for turn in turns),
                "mb_per_cpu_s": statistics.median(turn.mb_per_cpu_s for turn in turns),
                "wall_s": statistics.median(turn.wall_s for turn in turns),
                "cpu_s": statistics.median(turn.cpu_s for turn in turns),
            }
        )
    return {
        "log_mb": log.stat().st_size / 1e6,
        "events": len(read_index(log)),
        "copies": copies,
        "index_mb": index_file(log).stat().st_size / 1e6 if index_file(log).exists() else 0.0,
        "rows": rows,
        "rounds": len(rounds),
        "load_average": os.getloadavg()[0],
        "git_revision": run_folder.git_revision(),
        "host": run_folder.host(),
    }


def in_turns(log: Path, rounds: int, told: Callable[[str, Measured], None]) -> list[dict[str, Measured]]:
    """Every reader once a round, and start-up last, when the index is there."""
    found: list[dict[str, Measured]] = []
    for _ in range(rounds):
        turn = {}
        for name, work in readers(log).items():
            turn[name] = measure(work)
            told(name, turn[name])
        turn["start: tandem log info, whole command"] = start_up(log)
        told("start: tandem log info, whole command", turn["start: tandem log info, whole command"])
        found.append(turn)
    return found
