"""Logs made by hand, small and with everything in them that the reader must tell apart."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tandem_lcm.tandem.episode_end_t import episode_end_t
from tandem_lcm.tandem.robot_state_t import robot_state_t

from tandem.log import raw_events
from tandem.wire import CHANNEL_OF

SYNC = 0xEDA1DA01


def event_bytes(number: int, timestamp: int, channel: str, data: bytes) -> bytes:
    """As LCM's documentation of the file format has it."""
    name = channel.encode()
    return struct.pack(">IQqII", SYNC, number, timestamp, len(name), len(data)) + name + data


def encoded(*messages: Any) -> list[bytes]:
    """Events of messages, 10 ms apart."""
    return [
        event_bytes(i, 10_000 * i, CHANNEL_OF[type(message)], message.encode())
        for i, message in enumerate(messages)
    ]


def state(tick: int, episode: int = 0) -> robot_state_t:
    message = robot_state_t()
    message.tick, message.utime, message.episode = tick, 1000 * tick, episode
    message.F_ext_W = [float(tick), 0.0, 0.0, 0.0, 0.0, -float(tick)]
    return message


def end(episode: int) -> episode_end_t:
    message = episode_end_t()
    message.episode, message.n_steps, message.phase = episode, 10, 1
    return message


def altered(log: Path, out: Path, change: Callable[[str, Any], Any]) -> Path:
    """A copy of a log. change(channel, message): alters the message; returns False to leave the event out."""
    pieces = []
    for event in raw_events(log):
        message = event.message
        if change(event.channel, message) is not False:
            pieces.append(event_bytes(len(pieces), event.timestamp, event.channel, message.encode()))
    out.write_bytes(b"".join(pieces))
    return out
