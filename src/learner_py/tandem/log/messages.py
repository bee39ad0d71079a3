"""What most readers want of an event log: typed messages, whole episodes, the scenario.

for event in messages("runs/peg/log.lcm", "EPISODE_END"): event.message.outcome
for episode in episodes("runs/peg/log.lcm"): ...
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tandem.learner.episode import Episode, EpisodeAssembler
from tandem.log.event_log import EventLog, RawEvent
from tandem.wire import decode


@dataclass(frozen=True)
class LogMessage:
    """One event of a log."""

    channel: str
    timestamp: int  # us, as recorded
    message: Any  # decoded, of the type that `wire.CHANNELS` names
    data: bytes  # as recorded


def raw_events(path: str | Path, channels: frozenset[str] | None = None) -> Iterator[RawEvent]:
    """Events of a log in its order, of some channels only when asked. Raises FileNotFoundError with a sentence."""
    log = EventLog(Path(path))
    return log.events(None if channels is None else log.index.rows(*channels))


def messages(path: str | Path, *channels: str) -> Iterator[LogMessage]:
    """Messages of these channels (of all known channels when none is named), in the order of the log.

    Events that do not decode are left out. Raises FileNotFoundError with a sentence when there is no such log.
    """
    for event in EventLog(Path(path)).messages(*channels):
        message = decode(event.channel, event.data)
        if message is not None:
            yield LogMessage(event.channel, event.timestamp, message, event.data)


def episodes(path: str | Path) -> Iterator[Episode]:
    """Complete episodes (every step there, digest agrees) in the order of their completion, each number once."""
    assembler = EpisodeAssembler()
    seen: set[int] = set()
    for event in messages(path, "EPISODE_STEP", "EPISODE_END"):
        if event.message.episode in seen:
            continue
        if event.channel == "EPISODE_STEP":
            assembler.add_step(event.message, event.data)
        else:
            assembler.add_end(event.message)
        episode = assembler.take(event.message.episode)
        if episode is not None:
            seen.add(episode.number)
            yield episode


def scenario_yaml(path: str | Path) -> str:
    """The resolved scenario that the log was made from. Raises ValueError with a sentence when the log has none."""
    for event in messages(path, "SCENARIO"):
        return str(event.message.scenario_yaml)
    raise ValueError(
        f"{path} holds no SCENARIO event; it was not recorded by tandem_controller or is cut off at the start."
    )
