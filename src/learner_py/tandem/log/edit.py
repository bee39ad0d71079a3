"""New logs from old ones, event by event as they were: `./tandem log cut` and `merge`.

What is written is a standard LCM event log, its events numbered anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tandem.log.event_log import EventLog
from tandem.log.events import HEADER, Array, overlapping
from tandem.log.files import refuse_leftovers

# What was said once and holds from then on.
STANDING = ("SCENARIO", "PROVENANCE", "IMPEDANCE_GAINS", "POLICY_ANNOUNCE")
_BATCH = 50_000  # events written at a time


def cut(log: EventLog, rows: Array, out: Path) -> int:
    """Writes these events, and before them what held when the first of them came. Returns how many events."""
    before = [log.index.rows(channel) for channel in STANDING]
    earlier = [of[of < rows[0]] for of in before] if len(rows) else []
    held = [of[-1] for of in earlier if len(of)]
    return _write(out, [log], [np.unique(np.append(rows, np.array(held, np.int64)))], None)


def merge(logs: Sequence[EventLog], out: Path, by: str = "timestamp") -> int:
    """Writes all events of several logs in the order of their times; each log keeps its own order.

    by: `timestamp` (when an event was written) or `utime` (when its message was made), which logs of different
    recorders have in common. Of equal times the earlier log's event comes first. Returns how many events.
    """
    times = [np.maximum.accumulate(log.index.columns[by]) for log in logs]
    order = np.argsort(np.concatenate(times), kind="stable")
    return _write(out, logs, [np.arange(len(log.index)) for log in logs], order)


def _write(out: Path, logs: Sequence[EventLog], rows: Sequence[Array], order: Array | None) -> int:
    """order: of the concatenated rows. Whole or not at all."""
    refuse_leftovers(out)
    source = np.repeat(np.arange(len(logs)), [len(r) for r in rows])
    row = np.concatenate(rows)
    if order is not None:
        source, row = source[order], row[order]
    partial = out.with_name(out.name + ".part")
    try:
        with partial.open("wb") as file:
            for begin in range(0, len(row), _BATCH):
                part = slice(begin, min(begin + _BATCH, len(row)))
                file.write(_numbered(_pieces(logs, source[part], row[part]), begin))
        partial.replace(out)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    return len(row)


def _pieces(logs: Sequence[EventLog], source: Array, row: Array) -> list[bytes]:
    """The events as they lie in their files."""
    pieces = [b""] * len(row)
    for i, log in enumerate(logs):
        places = np.flatnonzero(source == i)
        for place, piece in zip(places.tolist(), log.raw(row[places]), strict=False):
            pieces[place] = piece
    return pieces


def _numbered(pieces: list[bytes], first: int) -> bytes:
    data = np.frombuffer(bytearray(b"".join(pieces)), np.uint8)
    begins = np.cumsum([0, *(len(piece) for piece in pieces[:-1])])
    if len(pieces):
        overlapping(data, HEADER)["number"][begins] = first + np.arange(len(pieces))
    return data.tobytes()
