"""What an export reads: a log, the scenario that it was made from, and the episodes that were chosen."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.scenario_t import scenario_t

from tandem.learner.episode import PHASE_NAMES, Episode
from tandem.log import LogMessage, episodes, messages
from tandem.run_folder import RunFolderError, shown
from tandem.scenario import observed
from tandem.summary import read_episodes

_NO_END = 2**62  # of a range such as 3-


@dataclass(frozen=True)
class Source:
    log: Path
    made_from: scenario_t
    scenario: dict[str, Any]  # resolved, of made_from
    ends: dict[int, episode_end_t]  # chosen episodes by number, ascending
    whole: bool  # no episode was left out

    @property
    def observation_names(self) -> list[str]:
        return observed(self.scenario["run"].get("observe", "state"), self.scenario["task"]["observation"])

    @property
    def policy_rate_hz(self) -> int:
        return int(self.scenario["task"]["policy_rate_hz"])

    def episodes(self) -> Iterator[Episode]:
        """The chosen ones, complete, by number."""
        return iter(sorted((e for e in episodes(self.log) if e.number in self.ends), key=lambda e: e.number))

    def messages(self, *channels: str) -> Iterator[LogMessage]:
        """Those of the chosen episodes, in the order of the log.

        A message that names no episode belongs to the one that was going on when it was recorded.
        """
        current = -1
        for event in messages(self.log, *channels):
            named = getattr(event.message, "episode", getattr(event.message, "episode_answered", -1))
            current = named if named >= 0 else current
            if self.whole or current in self.ends or event.channel == "SCENARIO":
                yield event


def open_source(log: Path, numbers: str = "", phase: str = "") -> Source:
    """numbers: `3-10,15,20-`; phase: demonstration, training or evaluation; empty: all.

    Raises RunFolderError with a sentence when the log has no scenario or no such episode.
    """
    if phase and phase not in PHASE_NAMES.values():
        raise RunFolderError(f"--phase is {phase}; it must be one of {', '.join(PHASE_NAMES.values())}.")
    wanted = _ranges(numbers)
    recorded = next(messages(log, "SCENARIO"), None)
    if recorded is None:
        raise RunFolderError(
            f"{shown(log)} holds no SCENARIO event; it was not recorded by tandem_controller, "
            "or is cut off at the start."
        )
    ends = {end.episode: end for end in read_episodes(log)}
    chosen = {
        number: end
        for number, end in ends.items()
        if (not wanted or any(number in part for part in wanted))
        and (not phase or PHASE_NAMES.get(end.phase) == phase)
    }
    if not chosen:
        asked = " ".join([f"--episodes {numbers}"] * bool(numbers) + [f"--phase {phase}"] * bool(phase))
        held = f"episodes {min(ends)} to {max(ends)}" if ends else "no complete episode"
        raise RunFolderError(f"{shown(log)} holds {held}{f', and none for {asked}' if asked else ''}.")
    scenario = yaml.safe_load(recorded.message.scenario_yaml)
    return Source(log, recorded.message, scenario, chosen, whole=len(chosen) == len(ends))


def _ranges(numbers: str) -> list[range]:
    parts = []
    for word in filter(None, (word.strip() for word in numbers.split(","))):
        first, dash, last = word.partition("-")
        try:
            part = range(int(first), (int(last) if last else _NO_END if dash else int(first)) + 1)
        except ValueError:
            part = range(0)
        if not part:
            raise RunFolderError(f"--episodes {numbers}: {word} is no range; write for instance 3-10,15.")
        parts.append(part)
    return parts


@contextlib.contextmanager
def whole_or_not_at_all(path: Path) -> Iterator[Path]:
    """A name beside `path` to write a file or folder to; it is renamed at the end, and removed after a failure."""
    if path.exists():
        raise RunFolderError(f"{shown(path)} exists; give another --out, or remove it.")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.part")
    _remove(partial)
    try:
        yield partial
        partial.rename(path)
    finally:
        _remove(partial)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
