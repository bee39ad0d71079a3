"""The reader against LCM's own on sound logs, and on every kind of damage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import lcm
import numpy as np
import pytest
from handmade import encoded, end, event_bytes, state

from tandem.log import EventLog, events, raw_events
from tandem.log.index import Index, scan_log

Write = Callable[..., Path]


def as_lcm_reads(path: Path) -> list[tuple[int, int, str, bytes]]:
    return [(e.eventnum, e.timestamp, e.channel, e.data) for e in lcm.EventLog(str(path), "r")]


def random_log(seed: int, n: int = 4000) -> list[bytes]:
    """Foreign channels and data of every length, some of which look like events."""
    generator = np.random.default_rng(seed)
    decoy = event_bytes(7, 7, "DECOY", b"x" * 20)
    pieces = []
    for i in range(n):
        data = generator.bytes(int(generator.integers(0, 300)))
        if generator.random() < 0.2:
            data += decoy * int(generator.integers(1, 4)) + generator.bytes(3)
        channel = "C" * int(generator.integers(1, 64))
        pieces.append(event_bytes(i, 1000 * i, channel, data))
    return pieces


@pytest.mark.parametrize("block", [events.BLOCK, 100_000, 5_000])
def test_log_with_events_inside_of_data_is_read_as_lcm_reads_it(
    write: Write, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr(events, "BLOCK", block)  # 5000 B: events lie across blocks, and chains begin in data
    path = write(*random_log(block))
    assert [tuple(event) for event in raw_events(path)] == as_lcm_reads(path)


def test_event_larger_than_a_block_is_read(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "BLOCK", 1000)
    path = write(*random_log(1, 20), event_bytes(20, 0, "LARGE", b"z" * 50_000), *random_log(2, 20))
    assert [tuple(event) for event in raw_events(path)] == as_lcm_reads(path)


def test_cut_off_tail_is_read_up_to_the_cut_wherever_it_is(write: Write) -> None:
    pieces = encoded(state(0), end(0), state(1))
    whole = b"".join(pieces)
    bounds = np.cumsum([len(piece) for piece in pieces])
    for n in range(len(whole)):
        index = scan_log(write(whole[:n]))
        assert len(index) == np.searchsorted(bounds, n, side="right")
        assert index.damage == [] and index.end + index.cut_off_bytes == n


def test_damaged_bytes_cost_their_event_and_are_told(write: Write) -> None:
    pieces = encoded(*(state(tick) for tick in range(6)))
    broken = b"\0\0\0\0" + pieces[2][4:]  # its sync word
    index = scan_log(write(*pieces[:2], broken, *pieces[3:]))
    begin = len(pieces[0]) + len(pieces[1])
    assert index.damage == [(begin, begin + len(broken))]
    assert index.utime.tolist() == [0, 1000, 3000, 4000, 5000]


@pytest.mark.parametrize("length", [0, 1, 400, 700, 5000, 0x7FFFFFFF])
def test_wrong_length_costs_no_other_event(write: Write, length: int) -> None:
    pieces = encoded(*(state(tick) for tick in range(40)))
    broken = pieces[5][:24] + length.to_bytes(4, "big") + pieces[5][28:]
    log = EventLog(write(*pieces[:5], broken, *pieces[6:]))
    read = [event.message for event in log.messages("ROBOT_STATE")]
    ticks = [message.tick for message in read if message is not None]
    assert [tick for tick in ticks if tick != 5] == [*range(5), *range(6, 40)]
    assert log.index.damaged_bytes > 0


def test_garbage_before_between_and_after_events_is_skipped(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    garbage = np.random.default_rng(3).bytes(20_000)
    pieces = encoded(*(state(tick) for tick in range(30)))
    for block in (4096, 1 << 20):  # the garbage is longer than a block
        monkeypatch.setattr(events, "BLOCK", block)
        index = scan_log(write(garbage, *pieces[:10], garbage, *pieces[10:], garbage))
        assert index.utime.tolist() == [1000 * tick for tick in range(30)]
        assert [stop - begin for begin, stop in index.damage] == [len(garbage)] * 3
        assert index.cut_off_bytes == 0


def test_file_that_is_no_log_is_all_damage(write: Write) -> None:
    index = scan_log(write(b"This is a text.\n" * 100))
    assert len(index) == 0 and index.damage == [(0, 1600)]


def test_empty_log_has_no_events(write: Write) -> None:
    log = EventLog(write(b""))
    assert isinstance(log.index, Index) and len(log.index) == 0
    assert list(log.events()) == [] and len(log.episodes) == 0 and log.scenario == {}


def test_log_that_its_writer_cuts_meanwhile_ends_there(write: Write) -> None:
    pieces = encoded(*(state(tick) for tick in range(10)))
    path = write(*pieces)
    log = EventLog(path)
    path.write_bytes(b"".join(pieces[:4]) + pieces[4][:30])  # a run that continues cuts its log
    assert [event.message.tick for event in log.events()] == [0, 1, 2, 3]
