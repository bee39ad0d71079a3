"""Every CONTROL_TICK of a log against the limits of the robot; fast enough for millions of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tandem_lcm.tandem.control_tick_t import control_tick_t

from tandem.run_folder import raw_events

TORQUE_LIMIT = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # N m
TORQUE_STEP = 1.0  # N m from the command that the robot had to the next one
ROUNDING = 1e-9  # N m

# control_tick_t as it lies on the wire (big endian); held against the type's own decoder by tests/bench.
LAYOUT = np.dtype(
    [
        ("fingerprint", ">i8"),
        ("utime", ">i8"),
        ("tick", ">i8"),
        ("episode", ">i8"),
        ("missed_cycles", ">i4"),
        ("link_age_ms", ">f8"),
        ("q_measured", ">f8", 7),
        ("dq_measured", ">f8", 7),
        ("tau_external", ">f8", 7),
        ("tau_received", ">f8", 7),
        ("gripper_width", ">f8"),
        ("robot_mode", ">i4"),
        ("fault", ">i4"),
        ("tau_commanded", ">f8", 7),
    ]
)
_BLOCK = 20_000  # ticks


@dataclass
class TorqueFigures:
    """Worst values over all ticks, and the first tick that broke a limit."""

    ticks: int = 0
    undecodable: int = 0
    not_finite: int = 0
    beyond_limit: int = 0
    beyond_step: int = 0
    missed_cycles: int = 0
    largest_share: float = 0.0  # of a joint's torque limit
    largest_step: float = 0.0  # N m
    first_violation: str = ""
    episodes: set[int] = field(default_factory=set)  # that moved

    @property
    def violations(self) -> int:
        return self.undecodable + self.not_finite + self.beyond_limit + self.beyond_step


def check_torques(log: Path) -> TorqueFigures:
    figures = TorqueFigures()
    for block in _blocks(log, figures):
        _check(block, figures)
    return figures


def _blocks(log: Path, figures: TorqueFigures) -> Iterator[NDArray[np.void]]:
    fingerprint = control_tick_t._get_packed_fingerprint()
    parts: list[bytes] = []
    for event in raw_events(log, frozenset({"CONTROL_TICK"})):
        if len(event.data) != LAYOUT.itemsize or event.data[:8] != fingerprint:
            figures.undecodable += 1
            continue
        parts.append(event.data)
        if len(parts) == _BLOCK:
            yield np.frombuffer(b"".join(parts), LAYOUT)
            parts = []
    if parts:
        yield np.frombuffer(b"".join(parts), LAYOUT)


def _check(block: NDArray[np.void], figures: TorqueFigures) -> None:
    commanded, received = block["tau_commanded"], block["tau_received"]
    finite = np.isfinite(commanded).all(axis=1) & np.isfinite(received).all(axis=1)
    share = np.abs(np.where(finite[:, None], commanded, 0.0)) / TORQUE_LIMIT
    step = np.abs(np.where(finite[:, None], commanded - received, 0.0))
    beyond_limit = (share > 1.0 + ROUNDING).any(axis=1)
    beyond_step = (step > TORQUE_STEP + ROUNDING).any(axis=1)

    bad = ~finite | beyond_limit | beyond_step
    if bad.any() and not figures.first_violation:
        first = block[int(np.argmax(bad))]
        figures.first_violation = (
            f"episode {first['episode']}, tick {first['tick']}: commanded {first['tau_commanded'].tolist()} after "
            f"{first['tau_received'].tolist()}"
        )
    figures.ticks += len(block)
    figures.not_finite += int((~finite).sum())
    figures.beyond_limit += int(beyond_limit.sum())
    figures.beyond_step += int(beyond_step.sum())
    figures.missed_cycles += int(block["missed_cycles"].sum())
    figures.largest_share = max(figures.largest_share, float(share.max(initial=0.0)))
    figures.largest_step = max(figures.largest_step, float(step.max(initial=0.0)))
    figures.episodes.update(np.unique(block["episode"]).tolist())
