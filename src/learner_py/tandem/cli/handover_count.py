"""What policy swaps and hand-overs cost the control loop, counted in the log of one real-time run.

A missed tick is a cycle in which the robot got no command, because the control thread ran a whole period late or more;
CONTROL_TICK says how many there were before each tick. Those in a row are one stall, dated by its beginning: the tick
before it. Busy phases (swaps and hand-overs) are held against the quiet phases of the same run, because a machine
stalls without us as well.
"""

import bisect
import math
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tandem.log import LogMessage, messages

NEAR_US = 20_000  # so long after a swap or a hand-over a stall may be its doing
AUTHORITY = 0.9  # alpha that counts as having the arm

_CHANNELS = (
    "CONTROL_TICK",
    "ROBOT_STATE",
    "ACTION_CHUNK",
    "POLICY_ANNOUNCE",
    "TELEOP_COMMAND",
    "EPISODE_END",
)


@dataclass(frozen=True)
class Phase:
    """A stretch of the run, us on the monotonic clock: [start, end)."""

    busy: bool
    start: int
    end: int


@dataclass
class Recorded:
    """What the log of a real-time run says, tick by tick."""

    utime: array = field(default_factory=lambda: array("q"))  # us, when each tick began
    missed: array = field(default_factory=lambda: array("q"))  # cycles missed before it
    since: array = field(default_factory=lambda: array("q"))  # us, when the tick before it began
    torque_jump: array = field(
        default_factory=lambda: array("d")
    )  # N m, largest joint, against the tick before
    swaps: list[int] = field(default_factory=list)  # us, another policy's chunk took over
    announced_in_force: int = 0  # the same, as POLICY_ANNOUNCE counts it, the first one left out
    edges: list[int] = field(default_factory=list)  # us, ticks in which somebody engaged or let go
    handovers: int = 0  # alpha rose to 0.9 and came back to 0
    ticks_to_authority: list[int] = field(default_factory=list)  # of engagements from alpha = 0
    episodes: int = 0
    faults: list[int] = field(default_factory=list)

    @property
    def events(self) -> list[int]:
        """Swaps and hand-overs in either direction, ascending."""
        return sorted([*self.swaps, *self.edges])


def read(log: Path) -> Recorded:
    """Raises FileNotFoundError with a sentence."""
    return record(messages(log, *_CHANNELS))


def record(events: Iterable[LogMessage]) -> Recorded:
    """The controller logs what was handed over before the tick in which it took effect; so the next tick dates it."""
    found = Recorded()
    asked = engaged = False  # what the operator said last, and what the last tick acted on
    version = announced = 0
    engaged_at: int | None = None  # tick of an engagement that began at alpha = 0 and is not at 0.9 yet
    had_authority = False
    alpha = 0.0
    swapped = False
    last: Any = None  # CONTROL_TICK before this one, of the same episode
    for event in events:
        message: Any = event.message
        if event.channel == "TELEOP_COMMAND":
            asked = bool(message.engaged)
        elif event.channel == "POLICY_ANNOUNCE":
            found.announced_in_force += int(announced not in (0, message.version))
            announced = message.version
        elif event.channel == "ACTION_CHUNK":
            swapped |= version not in (0, message.policy_version)
            version = message.policy_version
        elif event.channel == "CONTROL_TICK":
            found.utime.append(message.utime)
            found.missed.append(message.missed_cycles)
            found.since.append(last.utime if last else message.utime - 1000 * (1 + message.missed_cycles))
            found.torque_jump.append(
                max(
                    abs(now - then)
                    for now, then in zip(message.tau_commanded, message.tau_received, strict=True)
                )
            )
            if swapped:
                found.swaps.append(message.utime)
            if asked != engaged:
                found.edges.append(message.utime)
                engaged_at = message.tick if asked and alpha == 0.0 else None
            engaged, swapped, last = asked, False, message
        elif event.channel == "ROBOT_STATE":
            alpha = message.alpha
            if alpha >= AUTHORITY:
                had_authority = True
                if engaged_at is not None:
                    found.ticks_to_authority.append(message.tick - engaged_at + 1)
                    engaged_at = None
            elif alpha == 0.0 and had_authority:
                found.handovers += 1
                had_authority = False
        elif event.channel == "EPISODE_END":
            found.episodes += 1
            if message.fault:
                found.faults.append(int(message.fault))
            # The next one begins in the policy's hands.
            asked = engaged = had_authority = False
            engaged_at, alpha, last = None, 0.0, None
    return found


def count(found: Recorded, phases: Sequence[Phase]) -> dict[str, Any]:
    """The figures, by the names that other tools read."""
    utime, missed, since = (np.array(values, np.int64) for values in (found.utime, found.missed, found.since))
    jump = np.array(found.torque_jump)
    events = np.array(found.events, np.int64)
    stalled = missed > 0
    ticks_near = near(utime, events)

    def part(ticks: np.ndarray, stalls: np.ndarray) -> dict[str, Any]:
        """ticks, stalls: which of them belong to it."""
        cycles = int(np.count_nonzero(ticks)) + int(missed[stalls].sum())
        return {
            "cycles": cycles,
            "missed_ticks": int(missed[stalls].sum()),
            "stalls": int(np.count_nonzero(stalls & stalled)),
            "longest_stall_cycles": int(missed[stalls].max(initial=0)),
        }

    def of_phases(busy: bool) -> dict[str, Any]:
        wanted = [phase for phase in phases if phase.busy == busy]
        seconds = sum(phase.end - phase.start for phase in wanted) / 1e6
        return {
            "phases": len(wanted),
            "seconds": seconds,
            **part(within(utime, wanted), within(since, wanted)),
        }

    quiet = of_phases(False)
    busy = of_phases(True)
    directly = part(np.isin(utime, events), np.isin(since, events))
    after = part(ticks_near, near(since, events))
    for counted in (busy, directly, after):
        counted["missed_ticks_beyond_quiet"] = excess(counted, quiet)
        counted["stalls_p_value"] = more_often(counted, quiet)
    return {
        "swaps": len(found.swaps),
        "swaps_announced_in_force": found.announced_in_force,
        "handovers": found.handovers,
        "engagements_and_releases": len(found.edges),
        "episodes": found.episodes,
        "faults": found.faults,
        "ticks": len(utime),
        "missed_ticks": int(missed.sum()),
        "busy": busy,
        "quiet": quiet,
        "event_ticks": directly,  # those in which a swap or a hand-over took effect, up to the next one
        "within_20ms_after_event": after,
        "largest_torque_jump_Nm": float(jump.max(initial=0.0)),
        "largest_torque_jump_within_20ms_Nm": float(jump[ticks_near].max(initial=0.0)),
        "ticks_to_authority": _spread(found.ticks_to_authority),
    }


def near(times: np.ndarray, events: np.ndarray) -> np.ndarray:
    """Which times lie in the 20 ms from an event on; `events` ascending."""
    if not len(events):
        return np.zeros(len(times), bool)
    latest = np.searchsorted(events, times, side="right") - 1
    return (latest >= 0) & (times - events[latest] < NEAR_US)


def within(times: np.ndarray, phases: Sequence[Phase]) -> np.ndarray:
    inside = np.zeros(len(times), bool)
    for phase in phases:
        inside |= (times >= phase.start) & (times < phase.end)
    return inside


def excess(busy: dict[str, Any], quiet: dict[str, Any]) -> float:
    """Missed ticks of `busy` beyond what the rate of `quiet` explains; below 0 when it had fewer."""
    share = busy["cycles"] / quiet["cycles"] if quiet["cycles"] else 0.0
    return float(busy["missed_ticks"] - share * quiet["missed_ticks"])


def more_often(busy: dict[str, Any], quiet: dict[str, Any]) -> float:
    """Exact test of two Poisson rates: how probable so many stalls in `busy` are when both have the same rate.

    One-sided. Given the n stalls of both, those of `busy` are binomial with its share of the cycles. Stalls, not
    missed ticks: ticks that are missed in a row are not independent.
    """
    n, k = busy["stalls"] + quiet["stalls"], busy["stalls"]
    cycles = busy["cycles"] + quiet["cycles"]
    share = busy["cycles"] / cycles if cycles else 0.0
    if k == 0 or not 0.0 < share < 1.0:
        return 1.0
    log_of = [
        math.lgamma(n + 1) - math.lgamma(i + 1) - math.lgamma(n - i + 1)
        + i * math.log(share) + (n - i) * math.log1p(-share)
        for i in range(k, n + 1)
    ]  # fmt: skip
    return min(1.0, math.fsum(math.exp(value) for value in log_of))


def ticks_beyond(histogram: dict[str, Any], limit_us: float) -> int:
    """Entries of a histogram of the controller's results at or above a limit; its last bucket is open."""
    edges = [i * histogram["bucket_us"] for i in range(len(histogram["counts"]))]
    return sum(histogram["counts"][bisect.bisect_left(edges, limit_us - 1e-6) :])


def _spread(values: Sequence[int]) -> dict[str, Any]:
    if not values:
        return {"n": 0, "min": None, "p50": None, "p99": None, "max": None}
    p50, p99 = np.percentile(values, [50, 99])
    return {"n": len(values), "min": min(values), "p50": float(p50), "p99": float(p99), "max": max(values)}
