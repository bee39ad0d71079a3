"""Where the events of an LCM event log begin: found many at a time, without a loop over events.

An event is a header of 28 bytes, big endian, then its channel and its data:

    sync 0xEDA1DA01 (u32), number (u64), timestamp (us, i64), length of channel (u32), length of data (u32)

Only an event tells where the next one begins, so a log is a chain. `scan` begins at hundreds of sync words at once and
walks all these chains in step; where one ends exactly on the beginning of the next, they are the chain that a reader
from the front would have followed. Where they do not meet (a sync word inside of somebody's data), it goes on by
single events until they do.

Damaged bytes are skipped to the next event and told; so is an event whose length is damaged, known by there being no
event after it but one within it. A log that ends within an event (its writer was killed, or is still at it) is read up
to there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SYNC = 0xEDA1DA01
SYNC_BYTES = SYNC.to_bytes(4, "big")
HEADER = np.dtype(
    [("sync", ">u4"), ("number", ">u8"), ("timestamp", ">i8"), ("n_channel", ">u4"), ("n_data", ">u4")]
)
LONGEST_CHANNEL = 63  # bytes, LCM_MAX_CHANNEL_NAME_LENGTH
LARGEST_DATA = 1 << 28  # bytes, LCM_MAX_MESSAGE_SIZE
BLOCK = 16 << 20  # bytes read at a time
CHAINS = 512  # walked in step in a block

Array = NDArray[Any]


@dataclass
class Positions:
    """Beginnings of events in the file, ascending, and what lies between them that is none."""

    offsets: Array  # (N,) int64
    damage: list[tuple[int, int]] = field(default_factory=list)  # [begin, end) in bytes
    end: int = 0  # up to where the file was understood: a cut-off event begins here, or the file ends


def overlapping(buffer: Array, dtype: np.dtype[Any]) -> Array:
    """Records of `dtype` at every byte: overlapping(b, HEADER)[[0, 7]] are the headers at bytes 0 and 7."""
    n = max(0, len(buffer) - dtype.itemsize + 1)
    return np.ndarray((n,), dtype, np.ascontiguousarray(buffer), strides=(1,))


def blocks(path: Path, begin: int, end: int) -> Iterator[tuple[int, Array, Positions]]:
    """(offset of the block, its bytes, the events that lie in it whole), from `begin`, where an event begins.

    The last block's `end` is that of the file as far as it was understood. Bytes are only valid until the next block.
    """
    size = BLOCK
    buffer = np.empty(min(size, max(end - begin, 0)), np.uint8)
    with path.open("rb", buffering=0) as file:
        while begin < end:
            wanted = min(size, end - begin)
            if len(buffer) < wanted:
                buffer = np.empty(wanted, np.uint8)
            file.seek(begin)
            n = _fill(file, buffer[:wanted])
            last = begin + wanted == end or n < wanted
            found = scan(buffer[:n], last)
            progress = found.end
            _shift(found, begin)
            if progress == 0 and not last:
                size *= 2  # an event larger than a block
                continue
            size = BLOCK
            yield begin, buffer[:n], found
            if last:
                return
            begin += progress


def _fill(file: Any, buffer: Array) -> int:
    n = 0
    while n < len(buffer) and (got := file.readinto(buffer[n:])):
        n += got
    return n


def _shift(found: Positions, by: int) -> None:
    found.offsets += by
    found.damage = [(begin + by, end + by) for begin, end in found.damage]
    found.end += by


def scan(buffer: Array, last: bool) -> Positions:
    """Events that lie whole in a buffer that begins with one.

    last: nothing comes after it, so what is not whole will never be. Else `end` is where to go on, with more bytes.
    """
    starts, ends = _walk(buffer, _beginnings(buffer))
    broken = np.flatnonzero(ends[:-1] != starts[1:])  # i and i + 1 do not meet
    taken: list[Array] = []
    damage: list[tuple[int, int]] = []
    at = 0
    before = -1  # the event that ended here
    while at < len(buffer):
        i = int(np.searchsorted(starts, at))
        if i < len(starts) and starts[i] == at:
            j = int(np.searchsorted(broken, i))
            stop = int(broken[j]) + 1 if j < len(broken) else len(starts)
            taken.append(starts[i:stop])
            before, at = int(starts[stop - 1]), int(ends[stop - 1])
            continue
        end = _claimed_end(buffer, at)
        if 0 < end <= len(buffer):
            taken.append(np.array([at]))
            before, at = at, end
            continue
        begun = end > 0 or _is_prefix(buffer, at)
        if begun and not last:
            break
        # Nothing begins here: an event before it may have told a wrong length.
        search = before + HEADER.itemsize if before >= 0 and not begun else at + 1
        following = _next_event(buffer, search, last)
        if following is None:
            if not begun:
                rest = len(buffer) if last else max(at, len(buffer) - len(SYNC_BYTES) + 1)
                damage.append((at, rest))
                at = rest
            break
        if following < at:
            taken[-1] = taken[-1][:-1]
            at = before
        damage.append((at, following))
        at, before = following, -1
    offsets = np.concatenate(taken) if taken else np.empty(0, np.int64)
    return Positions(offsets.astype(np.int64), damage, at)


def _beginnings(buffer: Array) -> Array:
    """Where chains may begin: the front, and the first sync word after each of CHAINS places."""
    found = [0]
    stride = max(4096, len(buffer) // CHAINS)
    for place in range(stride, len(buffer), stride):
        at = _find_sync(buffer, place, min(place + stride, len(buffer)))
        if at > found[-1]:
            found.append(at)
    return np.array(found, np.int64)


def _walk(buffer: Array, begin: Array) -> tuple[Array, Array]:
    """(starts, ends) of the events on all chains, ascending; each chain goes to where the next one began."""
    headers = overlapping(buffer, HEADER)
    limit = np.append(begin[1:], len(buffer))
    at = begin
    starts, ends = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    while len(at):
        inside = at < len(headers)
        at, limit = at[inside], limit[inside]
        head = headers[at]
        n_channel, n_data = head["n_channel"].astype(np.int64), head["n_data"].astype(np.int64)
        end = at + HEADER.itemsize + n_channel + n_data
        whole = (head["sync"] == SYNC) & (end <= len(buffer)) & (n_data <= LARGEST_DATA)
        whole &= (n_channel >= 1) & (n_channel <= LONGEST_CHANNEL)
        at, end, limit = at[whole], end[whole], limit[whole]
        starts.append(at)
        ends.append(end)
        on = end < limit
        at, limit = end[on], limit[on]
    all_starts, all_ends = np.concatenate(starts), np.concatenate(ends)
    order = np.argsort(all_starts, kind="stable")
    return all_starts[order], all_ends[order]


def _claimed_end(buffer: Array, at: int) -> int:
    """Where the event at this byte ends by its header, within the buffer or beyond; 0 when no header lies there."""
    raw = buffer[at : at + HEADER.itemsize].tobytes()
    if len(raw) < HEADER.itemsize or raw[:4] != SYNC_BYTES:
        return 0
    n_channel, n_data = int.from_bytes(raw[20:24], "big"), int.from_bytes(raw[24:28], "big")
    sane = 1 <= n_channel <= LONGEST_CHANNEL and n_data <= LARGEST_DATA
    return at + HEADER.itemsize + n_channel + n_data if sane else 0


def _is_prefix(buffer: Array, at: int) -> bool:
    """Does the buffer end within a header that begins at this byte?"""
    head = buffer[at : at + HEADER.itemsize].tobytes()
    return len(head) < HEADER.itemsize and SYNC_BYTES.startswith(head[:4])


def _next_event(buffer: Array, begin: int, last: bool) -> int | None:
    """The first event from `begin` on that another one, or the end, follows."""
    at = _find_sync(buffer, begin, len(buffer))
    while at >= 0:
        end = _claimed_end(buffer, at)
        follows = buffer[end : end + 4].tobytes()
        if end and (end == len(buffer) or follows == SYNC_BYTES or (end > len(buffer) - 4 and not last)):
            return at
        at = _find_sync(buffer, at + 1, len(buffer))
    return None


def _find_sync(buffer: Array, begin: int, end: int) -> int:
    """The first sync word that begins in [begin, end), -1 when there is none."""
    window = 4096
    while begin < end:
        stop = min(begin + window, end)
        at = buffer[begin : stop + len(SYNC_BYTES) - 1].tobytes().find(SYNC_BYTES)
        if at >= 0:
            return begin + at
        begin, window = stop, min(2 * window, 1 << 20)
    return -1
