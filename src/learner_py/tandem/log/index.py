"""Every event of a log in columns, kept in a file beside the log so that the next look starts at once.

    index = read_index(Path("runs/peg/log.lcm"))
    index.rows("EPISODE_END")      # numbers of events, ascending

RUN/log.lcm.index is a safetensors file with the columns and what they were made from; each file of a log has its own.
It is believed only as far as the log still is what it was: the same size and time of change, the same first bytes. When
the log has grown and ends, up to where it ended, with the same bytes, the new events are added; else everything is read
again. It may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from tandem.log.events import HEADER, Array, blocks, overlapping
from tandem.log.files import files_of
from tandem.wire import CHANNELS

VERSION = "1"
KEPT_FROM_BYTES = 16 << 20  # smaller logs are read faster than anybody asks
_EDGE = 4096  # bytes compared at the beginning and before the end
_PREFIX = np.dtype([("fingerprint", ">i8"), ("utime", ">i8")])  # how each of our messages begins
_COLUMNS = {
    "offset": np.int64,  # of the header in the file
    "timestamp": np.int64,  # us, when it was written
    "utime": np.int64,  # us, of the message; the timestamp when it has none
    "size": np.uint32,  # bytes of data
    "channel": np.uint16,  # index into `channels`
    "readable": np.uint8,  # 1: the fingerprint is that of the channel's type
}

Progress = Callable[[float], None]


@dataclass
class Index:
    """One row an event, in the order of the log. Bytes are counted through all its files."""

    channels: list[str] = field(default_factory=list)
    columns: dict[str, Array] = field(
        default_factory=lambda: {name: np.empty(0, dtype) for name, dtype in _COLUMNS.items()}
    )
    damage: list[tuple[int, int]] = field(default_factory=list)  # [begin, end) bytes that are no events
    end: int = 0  # bytes understood; what follows is an event cut off
    n_bytes: int = 0  # of the log when it was read
    files: list[Path] = field(default_factory=list)
    begins: list[int] = field(default_factory=list)  # byte at which each file begins

    def __len__(self) -> int:
        return len(self.columns["offset"])

    def __getattr__(self, name: str) -> Array:
        """A column: offset, timestamp, utime, size, channel, readable."""
        if name in _COLUMNS:
            return self.columns[name]
        raise AttributeError(name)

    @property
    def cut_off_bytes(self) -> int:
        return self.n_bytes - self.end

    @property
    def damaged_bytes(self) -> int:
        return sum(end - begin for begin, end in self.damage)

    def rows(self, *channels: str, readable: bool = False) -> Array:
        """Events on these channels (on all when none is named), ascending; readable: those of their type only."""
        parts = [self._by_channel[name] for name in channels or self.channels if name in self._by_channel]
        rows = parts[0] if len(parts) == 1 else np.sort(np.concatenate([np.empty(0, np.int64), *parts]))
        return rows[self.columns["readable"][rows] != 0] if readable else rows

    @cached_property
    def _by_channel(self) -> dict[str, Array]:
        order = np.argsort(self.columns["channel"], kind="stable")
        bounds = np.cumsum(np.bincount(self.columns["channel"], minlength=len(self.channels)))
        return dict(zip(self.channels, np.split(order, bounds[:-1]), strict=True)) if self.channels else {}


def index_file(log: Path) -> Path:
    return log.with_name(log.name + ".index")


def read_index(log: Path, progress: Progress = lambda _share: None) -> Index:
    """The index of a log as it is now; writes or refreshes the files beside it when the log is large."""
    files = files_of(log)
    keep = sum(file.stat().st_size for file in files) >= KEPT_FROM_BYTES

    def part(number: int, file: Path) -> Index:
        return _read_file(file, keep, lambda share: progress((number + share) / len(files)))

    return _joined(files, [part(number, file) for number, file in enumerate(files)])


def scan_log(log: Path) -> Index:
    """The same from the log alone."""
    files = files_of(log)
    return _joined(files, [_extend(file, Index(), file.stat().st_size) for file in files])


def _read_file(file: Path, keep: bool, progress: Progress) -> Index:
    state = file.stat()
    index = _load(file, state)
    if index.n_bytes == state.st_size and len(index):
        return index
    index = _extend(file, index, state.st_size, progress)
    if keep:
        _save(file, index, state)
    return index


def _joined(files: list[Path], parts: list[Index]) -> Index:
    """One index of files that follow each other. What is cut off before the last one is damage."""
    if len(parts) == 1:
        parts[0].files, parts[0].begins = files, [0]
        return parts[0]
    whole = Index(files=files)
    columns: dict[str, list[Array]] = {name: [] for name in _COLUMNS}
    for part in parts:
        begin = whole.n_bytes
        if whole.end < begin:
            whole.damage.append((whole.end, begin))
        whole.channels += [name for name in part.channels if name not in whole.channels]
        number = np.array([whole.channels.index(name) for name in part.channels] or [0])
        for name in _COLUMNS:
            columns[name].append(part.columns[name])
        columns["offset"][-1] = part.offset + begin
        columns["channel"][-1] = number[part.channel]
        whole.damage += [(first + begin, stop + begin) for first, stop in part.damage]
        whole.end, whole.n_bytes = begin + part.end, begin + part.n_bytes
        whole.begins.append(begin)
    whole.columns = {name: np.concatenate(of).astype(_COLUMNS[name]) for name, of in columns.items()}
    return whole


def _extend(log: Path, index: Index, size: int, progress: Progress = lambda _share: None) -> Index:
    channels, damage = list(index.channels), list(index.damage)
    parts = {name: [column] for name, column in index.columns.items()}
    end = begin = index.end
    for offset, buffer, found in blocks(log, begin, size):
        for name, column in _facts(buffer, found.offsets - offset, channels).items():
            parts[name].append(column)
        parts["offset"].append(found.offsets)
        for gap in found.damage:
            if damage and damage[-1][1] == gap[0]:
                gap = (damage.pop()[0], gap[1])
            damage.append(gap)
        end = found.end
        progress((end - begin) / max(1, size - begin))
    columns = {name: np.concatenate(column).astype(_COLUMNS[name]) for name, column in parts.items()}
    return Index(channels, columns, damage, end, size)


def _facts(buffer: Array, at: Array, channels: list[str]) -> dict[str, Array]:
    """Columns of the events that begin at these bytes; new channels are appended to `channels`."""
    headers = overlapping(buffer, HEADER)[at]
    n_channel, n_data = headers["n_channel"].astype(np.int64), headers["n_data"].astype(np.int64)
    channel = _channels(buffer, at + HEADER.itemsize, n_channel, channels)
    # The first 16 bytes of the data; a shorter message has neither fingerprint nor time that we know.
    data = at + HEADER.itemsize + n_channel
    long_enough = n_data >= _PREFIX.itemsize
    prefix = np.zeros(len(at), _PREFIX)
    prefix[long_enough] = overlapping(buffer, _PREFIX)[data[long_enough]]
    wanted = np.array([_fingerprint(name) for name in channels] or [0], np.int64)
    known = np.array([name in CHANNELS for name in channels] or [False])
    readable = long_enough & known[channel] & (prefix["fingerprint"].astype(np.int64) == wanted[channel])
    timestamp = headers["timestamp"].astype(np.int64)
    return {
        "timestamp": timestamp,
        "utime": np.where(readable, prefix["utime"].astype(np.int64), timestamp),
        "size": n_data,
        "channel": channel,
        "readable": readable,
    }


def _channels(buffer: Array, at: Array, length: Array, channels: list[str]) -> Array:
    """Which of `channels` each event is on: one comparison of all names for each channel that there is."""
    result = np.zeros(len(at), np.int64)
    for n in np.unique(length):
        same_length = np.flatnonzero(length == n)
        names = overlapping(buffer, np.dtype(f"V{n}"))[at[same_length]]
        rest = np.arange(len(same_length))
        while len(rest):
            name = names[rest[0]].tobytes().decode("utf-8", "replace")
            if name not in channels:
                channels.append(name)
            is_it = names[rest] == names[rest[0]]
            result[same_length[rest[is_it]]] = channels.index(name)
            rest = rest[~is_it]
    return result


def _fingerprint(channel: str) -> int:
    message_type: Any = CHANNELS.get(channel)
    return int.from_bytes(message_type._get_packed_fingerprint(), "big", signed=True) if message_type else 0


def _digest(log: Path, begin: int, end: int) -> str:
    with log.open("rb") as file:
        file.seek(begin)
        return hashlib.sha256(file.read(end - begin)).hexdigest()


def _types() -> dict[str, int]:
    return {channel: _fingerprint(channel) for channel in CHANNELS}


def _load(log: Path, state: os.stat_result) -> Index:
    """What the file beside the log tells and the log does not belie; an empty index when that is nothing."""
    try:
        with safe_open(index_file(log), framework="numpy") as file:
            facts = json.loads((file.metadata() or {})["facts"])
            grown = state.st_size > facts["n_bytes"]
            same = state.st_size == facts["n_bytes"] and state.st_mtime_ns == facts["mtime_ns"]
            if facts["version"] != VERSION or facts["types"] != _types() or not (same or grown):
                return Index()
            end = facts["end"]
            if facts["first"] != _digest(log, 0, min(_EDGE, end)):
                return Index()
            if grown and facts["last"] != _digest(log, max(0, end - _EDGE), end):
                return Index()
            columns = {name: file.get_tensor(name) for name in _COLUMNS}
    except (OSError, SafetensorError, KeyError, ValueError, TypeError):
        return Index()
    damage = [(begin, stop) for begin, stop in facts["damage"]]
    return Index(facts["channels"], columns, damage, end, facts["n_bytes"])


def _save(log: Path, index: Index, state: os.stat_result) -> None:
    """Whole or not at all; a folder that can't be written in has no index."""
    facts = {
        "version": VERSION,
        "types": _types(),
        "n_bytes": index.n_bytes,
        "mtime_ns": state.st_mtime_ns,
        "end": index.end,
        "first": _digest(log, 0, min(_EDGE, index.end)),
        "last": _digest(log, max(0, index.end - _EDGE), index.end),
        "channels": index.channels,
        "damage": index.damage,
    }
    partial = index_file(log).with_name(f".{log.name}.index.{os.getpid()}")
    try:
        save_file(index.columns, partial, {"facts": json.dumps(facts)})
        partial.chmod(state.st_mode & 0o666)
        partial.replace(index_file(log))
    except (OSError, SafetensorError):
        partial.unlink(missing_ok=True)
