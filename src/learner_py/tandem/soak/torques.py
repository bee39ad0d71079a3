"""Every CONTROL_TICK of a log against the limits of the robot; fast enough for millions of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tandem.log import EventLog

TORQUE_LIMIT = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # N m
TORQUE_STEP = 1.0  # N m from the command that the robot had to the next one
ROUNDING = 1e-9  # N m

_FIELDS = ("episode", "tick", "missed_cycles", "tau_commanded", "tau_received")


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
    opened, figures = EventLog(log), TorqueFigures()
    for block in opened.column_blocks("CONTROL_TICK", *_FIELDS):
        _check(block, figures)
    figures.undecodable = len(opened.index.rows("CONTROL_TICK")) - figures.ticks
    return figures


def _check(block: dict[str, NDArray[Any]], figures: TorqueFigures) -> None:
    commanded, received = block["tau_commanded"], block["tau_received"]
    finite = np.isfinite(commanded).all(axis=1) & np.isfinite(received).all(axis=1)
    share = np.abs(np.where(finite[:, None], commanded, 0.0)) / TORQUE_LIMIT
    step = np.abs(np.where(finite[:, None], commanded - received, 0.0))
    beyond_limit = (share > 1.0 + ROUNDING).any(axis=1)
    beyond_step = (step > TORQUE_STEP + ROUNDING).any(axis=1)

    bad = ~finite | beyond_limit | beyond_step
    if bad.any() and not figures.first_violation:
        first = int(np.argmax(bad))
        figures.first_violation = (
            f"episode {block['episode'][first]}, tick {block['tick'][first]}: commanded "
            f"{commanded[first].tolist()} after {received[first].tolist()}"
        )
    figures.ticks += len(bad)
    figures.not_finite += int((~finite).sum())
    figures.beyond_limit += int(beyond_limit.sum())
    figures.beyond_step += int(beyond_step.sum())
    figures.missed_cycles += int(block["missed_cycles"].sum())
    figures.largest_share = max(figures.largest_share, float(share.max(initial=0.0)))
    figures.largest_step = max(figures.largest_step, float(step.max(initial=0.0)))
    figures.episodes.update(np.unique(block["episode"]).tolist())
