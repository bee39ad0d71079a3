"""What a check finds: kinds, places, sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from tandem.log.events import Array

KEPT = 20  # findings of a kind that are told; all are counted

# kind -> what it asks
KINDS = {
    "damage": "bytes that are no events",
    "undecodable": "messages that are not of their channel's type",
    "scenario": "the log begins with its SCENARIO",
    "episodes": "episode numbers without gaps; env steps add up",
    "steps": "every step of every episode is there, and the digest agrees",
    "gaps": "ticks and steps follow each other",
    "overruns": "no control cycle passed without a command; the recorder kept up",
    "torque": "torques are finite, within the robot's limits and rates",
    "workspace": "the pose that the arm tracks stays in the workspace",
    "actions": "actions in [-1, 1], masked axes 0, authority in [0, 1]",
    "executed": "what was executed lies between standing still and what policy and human asked (lockstep)",
    "intervention": "steps are called interventions when, and only when, the human was engaged",
    "returns": "rewards and returns, computed again",
    "policies": "every policy that acted was announced; policy files that are there have the announced digest",
    "faults": "episodes that ended in a fault (note)",
    "force": "forces above what the law alone can press with (note)",
    "cut_off": "an event cut off at the end (note)",
}
NOTES = frozenset({"faults", "force", "cut_off"})


@dataclass(frozen=True)
class Finding:
    kind: str
    sentence: str
    episode: int | None = None
    tick: int | None = None

    @property
    def is_error(self) -> bool:
        return self.kind not in NOTES

    def __str__(self) -> str:
        place = "" if self.episode is None else f"episode {self.episode}"
        place += "" if self.tick is None else f", tick {self.tick}"
        return f"{self.kind}: {place + ': ' if place else ''}{self.sentence}"


@dataclass
class Report:
    """The first KEPT findings of each kind, and how many there are of each."""

    findings: list[Finding] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def add(self, kind: str, sentence: str, episode: Any = None, tick: Any = None, count: int = 1) -> None:
        if self.counts[kind] < KEPT:
            place = (None if value is None else int(value) for value in (episode, tick))
            self.findings.append(Finding(kind, sentence, *place))
        self.counts[kind] += count

    def where(
        self,
        kind: str,
        wrong: Array | np.bool_,
        sentence: Callable[..., str],
        episode: Array,
        tick: Array | None = None,
    ) -> None:
        """One finding for each row that is wrong; the sentence is made for the rows that are told."""
        rows = np.flatnonzero(wrong)
        told = rows[: max(0, KEPT - self.counts[kind])]
        for i in told.tolist():
            self.add(kind, sentence(i), episode[i], None if tick is None else tick[i])
        if len(rows):
            self.counts[kind] += len(rows) - len(told)

    @property
    def errors(self) -> int:
        return sum(n for kind, n in self.counts.items() if kind not in NOTES)

    def as_json(self) -> dict[str, Any]:
        return {
            "errors": self.errors,
            "counts": dict(self.counts),
            "findings": [asdict(finding) | {"error": finding.is_error} for finding in self.findings],
        }


def shown(values: Array) -> str:
    """Numbers in a sentence."""
    return "[" + " ".join(f"{value:.4g}" for value in np.asarray(values).tolist()) + "]"
