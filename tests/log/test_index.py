"""The file beside a log: believed as far as the log is still what it was."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from handmade import encoded, end, state

from tandem.log import index as index_module
from tandem.log.index import Index, index_file, read_index, scan_log

Write = Callable[..., Path]


@pytest.fixture(autouse=True)
def every_log_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_module, "KEPT_FROM_BYTES", 0)


@pytest.fixture
def scanned(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Collects from which byte on the log itself was read."""
    begins: list[int] = []
    original = index_module.blocks

    def blocks(path: Path, begin: int, stop: int):  # type: ignore[no-untyped-def]
        begins.append(begin)
        return original(path, begin, stop)

    monkeypatch.setattr(index_module, "blocks", blocks)
    return begins


def same(a: Index, b: Index) -> bool:
    return (
        a.channels == b.channels
        and (a.damage, a.end, a.n_bytes) == (b.damage, b.end, b.n_bytes)
        and all(np.array_equal(a.columns[name], b.columns[name]) for name in a.columns)
    )


def test_second_look_reads_nothing_of_the_log(write: Write, scanned: list[int]) -> None:
    path = write(*encoded(state(0), end(0), state(1)))
    first = read_index(path)
    assert same(read_index(path), first) and same(first, scan_log(path))
    assert len(scanned) == 2  # the first look, and scan_log
    assert [first.channels[i] for i in first.channel] == ["ROBOT_STATE", "EPISODE_END", "ROBOT_STATE"]


def test_log_that_grew_is_read_from_where_it_ended(write: Write, scanned: list[int]) -> None:
    pieces = encoded(*(state(tick) for tick in range(20)), end(0))
    path = write(*pieces[:5], pieces[5][:100])  # caught within an event
    assert read_index(path).cut_off_bytes == 100
    path.write_bytes(b"".join(pieces))
    grown = read_index(path)
    assert scanned == [0, sum(len(piece) for piece in pieces[:5])]
    assert same(grown, scan_log(path)) and len(grown) == 21


@pytest.mark.parametrize("change", ["first bytes", "time of change", "cut and grown anew", "shorter", "type"])
def test_index_of_a_log_that_is_another_now_is_not_believed(
    write: Write, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pieces = encoded(*(state(tick) for tick in range(40)))
    path = write(*pieces)
    read_index(path)
    if change == "first bytes":
        path.write_bytes(b"".join([*encoded(end(3)), *pieces]))
    elif change == "time of change":
        path.write_bytes(b"".join([*pieces[:20], *encoded(*(state(100 + t) for t in range(20)))]))
        os.utime(path, ns=(0, 1))
    elif change == "cut and grown anew":
        path.write_bytes(b"".join([*pieces[:20], *encoded(end(1), *(state(100 + t) for t in range(40)))]))
    elif change == "shorter":
        path.write_bytes(b"".join(pieces[:20]))
    else:
        monkeypatch.setattr(index_module, "_types", lambda: {"ROBOT_STATE": 1})
    assert same(read_index(path), scan_log(path))


@pytest.mark.parametrize("damage", ["cut", "garbage", "empty"])
def test_damaged_index_is_made_anew(write: Write, damage: str) -> None:
    path = write(*encoded(state(0), end(0)))
    expected = read_index(path)
    file = index_file(path)
    content = file.read_bytes()
    file.write_bytes({"cut": content[:-40], "garbage": b"x" * 500, "empty": b""}[damage])
    assert same(read_index(path), expected)
    assert file.read_bytes() == content


def test_index_that_cannot_be_written_costs_nothing_but_time(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(*encoded(state(0), end(0)))

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(index_module, "save_file", full)
    assert len(read_index(path)) == 2
    assert [file.name for file in path.parent.iterdir()] == ["log.lcm"]


def test_small_log_gets_no_file(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    path = write(*encoded(state(0)))
    read_index(path)
    assert not index_file(path).exists()
