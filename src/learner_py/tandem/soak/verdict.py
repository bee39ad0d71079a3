"""Asks the log and the ear everything that a soak is for."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from tandem import processes, run_folder
from tandem.log import messages
from tandem.run_folder import RunFolder
from tandem.soak.checks import (
    Check,
    delivered_once,
    faults_declared,
    garbage_refused,
    torques_within_limits,
)
from tandem.soak.ear import OPERATOR
from tandem.soak.run import Soaked

REFUSED_CHUNKS = ("expired", "duplicate", "out of order", "stale", "wrong size", "not finite")
_READ = ("CONTROLLER_FAULT", "EPISODE_END", "WORLD_STATE", "TELEOP_COMMAND", "IMPEDANCE_GAINS")
_COUNTERS = (
    "ticks",
    "overruns",
    "teleop_accepted",
    "teleop_rejected",
    "gains_accepted",
    "gains_rejected",
    "commands_rejected",
    "policies_rejected",
    "chunks_taken",
    "chunks_late",
    "starved_ticks",
    "records_dropped",
    "episodes_unacknowledged",
)
LIMITS = ("not finite", "wall", "joint position", "joint velocity", "torque", "torque rate")


def judge(folder: RunFolder, soaked: Soaked) -> list[Check]:
    faults, ends, begun, heard, n_gains = [], [], set(), set(), 0
    for event in messages(folder.log, *_READ):
        if event.channel == "CONTROLLER_FAULT":
            faults.append(event.message)
        elif event.channel == "EPISODE_END":
            ends.append(event.message)
            begun.add(event.message.episode)
        elif event.channel == "TELEOP_COMMAND":
            heard.add(event.message.operator_id)
        elif event.channel == "IMPEDANCE_GAINS":
            n_gains += 1
        else:
            begun.add(event.message.episode)
    ear, done = soaked.ear, soaked.monkey.done
    status, learner = ear.status, ear.learner
    return [
        _orderly(soaked),
        torques_within_limits(folder.log),
        faults_declared(faults, ends, begun, ear.halted_by, soaked.broken is None),
        delivered_once(
            ends,
            ear.acknowledged,
            soaked.monkey.forged_acknowledgements,
            learner.buffer_steps if learner is not None else None,
            learner.episodes_trained_through if learner is not None else None,
        ),
        garbage_refused(
            status,
            done["gains"],
            n_gains,
            sum(n for name, n in done.items() if name.startswith("garbage on")),
            heard - {OPERATOR},
        ),
        _stopped(soaked),
        _replayed(folder),
    ]


def counters(soaked: Soaked) -> dict[str, Any]:
    """CONTROLLER_STATUS at the end, by name."""
    status: Any = soaked.ear.status
    if status is None:
        return {}
    return {
        **{name: getattr(status, name) for name in _COUNTERS},
        "chunks_refused": dict(zip(REFUSED_CHUNKS, status.chunks_refused, strict=True)),
        "limited_ticks": dict(zip(LIMITS, status.limited_ticks, strict=True)),
        "policy_latency_ticks_max": status.policy_latency_ticks[1],
        "tick_us": dict(zip(("p50", "p99", "p999", "max"), status.wall_tick_us, strict=True)),
        "wakeup_us": dict(zip(("p50", "p99", "p999", "max"), status.wall_wakeup_us, strict=True)),
    }


def _orderly(soaked: Soaked) -> Check:
    return Check(
        "all programs alive, and ended when asked",
        soaked.broken is None,
        soaked.broken or "no program ended by itself, hung or stood still",
        {"exit_codes": soaked.exit_codes},
    )


def _stopped(soaked: Soaked) -> Check:
    ignored, given = soaked.monkey.ignored_estops, soaked.monkey.done["e-stop"]
    return Check(
        "every e-stop obeyed",
        ignored == 0,
        f"{ignored} of {given} e-stops were not followed by a halt"
        if ignored
        else f"{given} e-stops, {given} halts",
    )


def _replayed(folder: RunFolder) -> Check:
    name = "replay finds every torque again"
    with tempfile.TemporaryDirectory(prefix="tandem-soak-") as temporary:
        report = Path(temporary) / "replay.json"
        command: processes.Command = [
            run_folder.program("tandem_replay"),
            folder.log,
            "--root",
            run_folder.ROOT,
            "--json",
            report,
        ]
        if sentence := processes.missing_program(command):
            return Check(name, False, sentence)
        done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
        if not report.is_file():
            return Check(
                name, False, f"the replay ended with exit code {done.returncode}: {done.stderr.strip()}"
            )
        figures: dict[str, Any] = json.loads(report.read_text())
    differences = figures.get("differences", -1)
    return Check(
        name,
        done.returncode == 0 and differences == 0,
        f"{differences} differences in {figures.get('ticks', 0)} ticks",
        figures,
    )
