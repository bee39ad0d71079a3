"""An event log, opened: its index, its events, and fields of many messages as arrays.

    log = EventLog(Path("runs/peg/log.lcm"))
    for event in log.events(log.index.rows("EPISODE_END")): event.message
    log.columns("ROBOT_STATE", "tick", "F_ext_W")["F_ext_W"]     # (N, 6)

A log may be read while it is written, also while its writer cuts it (a run that continues): what is no longer there
ends the reading. So files are read, never mapped into memory.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from tandem.log.events import HEADER, Array, overlapping
from tandem.log.index import Index, Progress, read_index, scan_log
from tandem.log.layout import Layout, native
from tandem.wire import CHANNELS, decode

_BLOCK = 2 << 20  # bytes read at a time
_OF_THE_START = ("SCENARIO", "PROVENANCE")
_NEAR = 64 << 10  # bytes between two wanted events that are read rather than skipped


class RawEvent(NamedTuple):
    """One event of an LCM log, not decoded."""

    number: int  # as its writer counted
    timestamp: int  # us, when it was written
    channel: str
    data: bytes

    @property
    def message(self) -> Any | None:
        """Of the type of the channel; None when the channel is not ours or the bytes are not of its type."""
        return decode(self.channel, self.data)


@dataclass(frozen=True)
class Episodes:
    """Episodes that ended in a log, one row each, as their EPISODE_END tells; `first` to `last` are its events."""

    number: Array
    phase: Array
    outcome: Array
    n_steps: Array
    first: Array  # event number: the one after the end of the episode before
    last: Array  # event number of EPISODE_END

    def __len__(self) -> int:
        return len(self.number)

    def of(self, rows: Array) -> Array:
        """The episode (row of this table) that each event belongs to; one more than there are: after the last."""
        return np.searchsorted(self.last, rows)


class EventLog:
    """One log for reading, all its files. Raises FileNotFoundError with a sentence when there is none."""

    def __init__(
        self, path: Path, keep_index: bool = False, progress: Progress = lambda _share: None
    ) -> None:
        """keep_index: of a large log, write or refresh the file beside it, and start from it."""
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"There is no event log at {path}.")
        self.index: Index = read_index(self.path, progress) if keep_index else scan_log(self.path)

    def events(self, rows: Array | None = None) -> Iterator[RawEvent]:
        """These events (all when None), in the order given, which must ascend."""
        rows = np.arange(len(self.index)) if rows is None else rows
        for part, at, buffer in self._read(rows):
            number = overlapping(np.frombuffer(buffer, np.uint8), HEADER)["number"][at].tolist()
            timestamp, size = self.index.timestamp[part].tolist(), self.index.size[part].tolist()
            channel, begin = self.index.channel[part].tolist(), self._data_at(part, at).tolist()
            for i in range(len(part)):
                name = self.index.channels[channel[i]]
                yield RawEvent(number[i], timestamp[i], name, buffer[begin[i] : begin[i] + size[i]])

    def raw(self, rows: Array) -> Iterator[bytes]:
        """These events as they lie in the file, header included."""
        for part, at, buffer in self._read(rows):
            ends = (self._data_at(part, at) + self.index.size[part]).tolist()
            for begin, end in zip(at.tolist(), ends, strict=True):
                yield buffer[begin:end]

    def messages(self, *channels: str) -> Iterator[RawEvent]:
        """Readable events on these channels (on all when none is named)."""
        return self.events(self.index.rows(*channels, readable=True))

    def columns(self, channel: str, *names: str, rows: Array | None = None) -> dict[str, Array]:
        """Fields of a channel's readable messages as arrays with one row each, `row` telling which events they are.

        rows: only these events. Where arrays differ in length between messages, the column holds objects.
        """
        parts = list(self.column_blocks(channel, *names, rows=rows))
        return {name: _joined([part[name] for part in parts]) for name in ("row", *names)}

    def column_blocks(
        self, channel: str, *names: str, rows: Array | None = None
    ) -> Iterator[dict[str, Array]]:
        """The same in parts of some megabytes, for logs that do not fit into memory."""
        rows = self.index.rows(channel, readable=True) if rows is None else rows
        for part, at, buffer in self._read(rows):
            found = list(self._decoded(channel, part, self._data_at(part, at), buffer, names))
            if not found:
                continue
            if len(found) == 1:
                yield {"row": found[0][0], **found[0][1]}
                continue
            row = np.concatenate([decoded for decoded, _ in found])
            order = np.argsort(row)
            columns = {name: _joined([values[name] for _, values in found])[order] for name in names}
            yield {"row": row[order], **columns}

    def _decoded(
        self, channel: str, rows: Array, at: Array, data: bytes, names: tuple[str, ...]
    ) -> Iterator[tuple[Array, dict[str, Array]]]:
        """(rows, columns) for each shape of message in a buffer; what does not decode is left out."""
        buffer = np.frombuffer(data, np.uint8)
        size = self.index.size[rows]
        for n in np.unique(size).tolist():
            rest = np.flatnonzero(size == n)
            while len(rest):
                begin = int(at[rest[0]])
                sample = data[begin : begin + n]
                layout = Layout.of(CHANNELS[channel], sample)
                if layout is None:
                    one, rest = rows[rest[:1]], rest[1:]
                    if (message := decode(channel, sample)) is not None:
                        yield one, {name: _row_of(getattr(message, name)) for name in names}
                    continue
                records = overlapping(buffer, layout.dtype)[at[rest]]
                same = layout.fits(records)
                if not same.all():
                    records = records[same]
                yield rows[rest[same]], {name: native(records[name]) for name in names}
                rest = rest[~same]

    def _data_at(self, rows: Array, at: Array) -> Array:
        """Where the data of these events begin, whose headers begin at `at`."""
        return at + HEADER.itemsize + self._channel_bytes[self.index.channel[rows]]

    @cached_property
    def _channel_bytes(self) -> Array:
        return np.array([len(name.encode()) for name in self.index.channels], np.int64)

    def _read(self, rows: Array) -> Iterator[tuple[Array, Array, bytes]]:
        """(some of the rows, where their headers lie in the bytes, the bytes); what nobody wants is skipped."""
        files, begins = self.index.files, self.index.begins
        bounds = np.searchsorted(self.index.offset[rows], [*begins, self.index.n_bytes])
        for file, begin, (first, last) in zip(files, begins, itertools.pairwise(bounds), strict=True):
            yield from self._read_file(file, begin, rows[first:last])

    def _read_file(self, path: Path, offset: int, rows: Array) -> Iterator[tuple[Array, Array, bytes]]:
        """offset: of the file's first byte."""
        begins = self.index.offset[rows] - offset
        ends = self._data_at(rows, begins) + self.index.size[rows]
        pieces: list[bytes] = []
        first, held = 0, 0  # row, bytes
        shift = np.empty(len(rows), np.int64)  # from the file to the pieces
        with path.open("rb", buffering=0) as file:
            for i, stop in _stretches(begins, ends):
                begin = int(begins[i])
                wanted = int(ends[stop - 1]) - begin
                piece = os.pread(file.fileno(), wanted, begin)
                cut = len(piece) < wanted  # by its writer meanwhile
                if cut:
                    stop = i + int(np.searchsorted(ends[i:stop], begin + len(piece), side="right"))
                pieces.append(piece)
                shift[i:stop] = held - begin
                held += len(piece)
                if held >= _BLOCK or cut or stop == len(rows):
                    part = slice(first, stop)
                    yield (
                        rows[part],
                        begins[part] + shift[part],
                        pieces[0] if len(pieces) == 1 else b"".join(pieces),
                    )
                    first, pieces, held = stop, [], 0
                if cut:
                    return

    @cached_property
    def episodes(self) -> Episodes:
        """In the order of the log. An end that comes again (a log recorded from the network) counts once."""
        names = ("episode", "phase", "outcome", "n_steps")
        ends = self.columns("EPISODE_END", *names)
        once = np.append(True, np.diff(ends["episode"]) != 0)[: len(ends["row"])]
        last = ends["row"][once]
        first = np.append(0, last[:-1] + 1)[: len(last)]
        number, phase, outcome, n_steps = (ends[name][once] for name in names)
        return Episodes(number, phase, outcome, n_steps, first, last)

    @cached_property
    def begin_us(self) -> int:
        """When the first message was made; what only the start of a log tells (0 in lockstep) left out."""
        told = np.isin(
            self.index.channel, [i for i, n in enumerate(self.index.channels) if n in _OF_THE_START]
        )
        times = self.index.utime[~told] if len(told) else self.index.utime
        return int(times[0]) if len(times) else 0

    @cached_property
    def starts(self) -> list[Any]:
        """The SCENARIO messages."""
        return [message for event in self.messages("SCENARIO") if (message := event.message) is not None]

    @cached_property
    def scenario(self) -> dict[str, Any]:
        """The resolved scenario that the log begins with; empty when it has none."""
        for start in self.starts:
            found = yaml.load(start.scenario_yaml, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
            return found if isinstance(found, dict) else {}
        return {}


def _stretches(begins: Array, ends: Array) -> Iterator[tuple[int, int]]:
    """(first, after the last) of events that are read at once: without anything long between them that nobody wants,
    and of no more than a block unless one event has more."""
    apart = np.flatnonzero(begins[1:] - ends[:-1] > _NEAR) + 1
    for first, last in itertools.pairwise([0, *apart.tolist(), len(begins)]):
        while first < last:
            stop = last
            if ends[last - 1] - begins[first] > _BLOCK:
                stop = max(first + 1, int(np.searchsorted(ends[:last], begins[first] + _BLOCK, side="right")))
            yield first, stop
            first = stop


def _row_of(value: Any) -> Array:
    """(1, ...) of one message's field; an object when it is no array of numbers."""
    array = np.asarray(value)
    if array.dtype == object:
        array = np.empty((), object)
        array[()] = value
    return array[None]


def _joined(parts: list[Array]) -> Array:
    if not parts:
        return np.empty(0, np.int64)
    if len({part.shape[1:] for part in parts}) == 1:
        return np.concatenate(parts)
    result = np.empty(sum(len(part) for part in parts), object)
    result[:] = [row for part in parts for row in part]
    return result
