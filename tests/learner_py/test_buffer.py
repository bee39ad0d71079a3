"""Replay: every step of every episode is there, once, in its place, and listed in the sets that it belongs to."""

from __future__ import annotations

import numpy as np
import support

from tandem.learner.buffer import ReplayBuffer
from tandem.learner.windows import make_windows


def add(buffer, number, n_steps, odd=()):
    """Adds an episode; `odd`: its steps that belong to the set of this name."""
    windows = make_windows(support.episode(number, n_steps=n_steps), [0, 1], 2, 0.9, False)
    buffer.add(windows, {"all": np.ones(n_steps, bool), "odd": np.isin(np.arange(n_steps), odd)})


def contents(buffer):
    """(episode, step) of each row in use."""
    return [tuple(row) for row in np.asarray(buffer.arrays["observation"])[: buffer.size, :2].astype(int)]


def listed(buffer, name):
    """(episode, step) of the rows of a set, in the order in which they are listed."""
    rows = buffer.rows[name]
    return [contents(buffer)[row] for row in np.asarray(rows.listed)[: int(rows.n)]]


def make(capacity, first, monkeypatch):
    monkeypatch.setattr("tandem.learner.buffer.FIRST_ALLOCATION", first)
    buffer = ReplayBuffer(capacity, ["all", "odd"])
    buffer.allocate(width=3, horizon=2, n_axes=2)
    return buffer


def test_rows_survive_growth_in_powers_of_two(monkeypatch):
    buffer = make(1000, 8, monkeypatch)
    for number in range(6):
        add(buffer, number, 5 + number)
    assert contents(buffer) == listed(buffer, "all") == [(e, t) for e in range(6) for t in range(5 + e)]
    assert buffer.allocated == 64 and buffer.size == 45
    assert len(buffer.rows["all"].listed) == 64


def test_full_buffer_overwrites_the_oldest_rows(monkeypatch):
    buffer = make(10, 4, monkeypatch)
    for number in range(3):
        add(buffer, number, 4)
    assert buffer.size == 10 and buffer.allocated == 10
    newer = [(0, 2), (0, 3), (1, 0), (1, 1), (1, 2), (1, 3), (2, 0), (2, 1)]
    assert contents(buffer) == [(2, 2), (2, 3), *newer]


def test_sets_list_their_own_rows_and_count_them(monkeypatch):
    buffer = make(100, 16, monkeypatch)
    assert buffer.count("odd") == 0 and int(buffer.rows["odd"].n) == 0
    add(buffer, 0, 4, odd=[1, 3])
    add(buffer, 1, 4)
    add(buffer, 2, 3, odd=[0])
    assert listed(buffer, "odd") == [(0, 1), (0, 3), (2, 0)]
    assert buffer.count("odd") == 3 and buffer.count("all") == 11


def test_sets_are_listed_from_the_oldest_row_on_after_the_first_overwriting(monkeypatch):
    buffer = make(10, 4, monkeypatch)
    for number in range(3):
        add(buffer, number, 4, odd=[1, 3])
    assert listed(buffer, "all") == [(0, 2), (0, 3), *[(1, t) for t in range(4)], *[(2, t) for t in range(4)]]
    assert listed(buffer, "odd") == [(0, 3), (1, 1), (1, 3), (2, 1), (2, 3)]
    assert buffer.count("odd") == 5
    add(buffer, 3, 4)  # whoever is overwritten leaves the sets
    assert listed(buffer, "odd") == [(1, 3), (2, 1), (2, 3)] and buffer.count("odd") == 3
