"""Two logs event by event, bit for bit: `./tandem log compare`.

Left out: the times at which events were written, and fields named wall_*, which are measured on the machine's clock.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tandem.log.event_log import EventLog, RawEvent


def first_difference(a: Path, b: Path, channel: str = ".*") -> tuple[int, str | None]:
    """(events compared, a clause about the first difference or None); only channels that match, whole."""
    wanted = re.compile(channel)

    def matching(path: Path) -> Iterator[RawEvent]:
        log = EventLog(path)
        names = [name for name in log.index.channels if wanted.fullmatch(name)]
        return log.events(log.index.rows(*names)) if names else iter(())

    count = 0
    for left, right in itertools.zip_longest(matching(a), matching(b)):
        if left is None or right is None:
            longer, event = (b, right) if left is None else (a, left)
            return count, f"{longer} has more events, from {_place(event)} on"
        if left.channel != right.channel:
            return count, f"event {count} is {_place(left)} in {a} and {_place(right)} in {b}"
        if left.data != right.data and (clause := _message_difference(left, right)):
            return count, clause
        count += 1
    return count, None


def mask_wall(message: Any) -> Any:
    """The message with every wall_* field zeroed."""
    for name in message.__slots__:
        if name.startswith("wall_"):
            setattr(message, name, _zero(getattr(message, name)))
    return message


def _zero(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_zero(item) for item in value]
    return type(value)()


def _place(event: RawEvent) -> str:
    message = event.message
    parts = [
        f"{name} {getattr(message, name)}"
        for name in ("episode", "tick", "step", "chunk_id", "version")
        if hasattr(message, name)
    ]
    return f"{event.channel} (event {event.number}{''.join(', ' + part for part in parts)})"


def _message_difference(left: RawEvent, right: RawEvent) -> str | None:
    one, two = left.message, right.message
    if one is None or two is None:
        return f"{_place(left)}: the bytes differ"
    if mask_wall(one).encode() == mask_wall(two).encode():
        return None
    for name in one.__slots__:
        # repr, since NaN equals itself here and -0 differs from 0
        if repr(getattr(one, name)) != repr(getattr(two, name)):
            place, x, y = _innermost(name, getattr(one, name), getattr(two, name))
            return f"{_place(left)}: {place} is {_short(x)} and {_short(y)}"
    return f"{_place(left)}: the bytes differ"


def _innermost(name: str, x: Any, y: Any) -> tuple[str, Any, Any]:
    """The first differing element of two arrays of one shape, by name and index."""
    if isinstance(x, list | tuple) and len(x) == len(y):
        for i, (left, right) in enumerate(zip(x, y, strict=True)):
            if repr(left) != repr(right):
                return _innermost(f"{name}[{i}]", left, right)
    return name, x, y


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 200 else text[:200] + " ..."
