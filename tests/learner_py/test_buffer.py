"""Replay: every step of every episode is there, once, in its place."""

from __future__ import annotations

import numpy as np
import support

from tandem.learner.buffer import ReplayBuffer
from tandem.learner.windows import make_windows


def add(buffer, number, n_steps, eligible=True):
    windows = make_windows(support.episode(number, n_steps=n_steps), [0, 1], 2, 0.9, False)
    buffer.add(windows, np.full(n_steps, eligible))


def contents(buffer):
    """(episode, step) of each row in use."""
    return [tuple(row) for row in np.asarray(buffer.arrays["observation"])[: buffer.size, :2].astype(int)]


def make(capacity, first, monkeypatch):
    monkeypatch.setattr("tandem.learner.buffer.FIRST_ALLOCATION", first)
    buffer = ReplayBuffer(capacity)
    buffer.allocate(width=3, horizon=2, n_axes=2)
    return buffer


def test_rows_survive_growth_in_powers_of_two(monkeypatch):
    buffer = make(1000, 8, monkeypatch)
    for number in range(6):
        add(buffer, number, 5 + number)
    assert contents(buffer) == [(e, t) for e in range(6) for t in range(5 + e)]
    assert buffer.allocated == 64 and buffer.size == 45


def test_full_buffer_overwrites_the_oldest_rows(monkeypatch):
    buffer = make(10, 4, monkeypatch)
    for number in range(3):
        add(buffer, number, 4)
    assert buffer.size == 10 and buffer.allocated == 10
    assert contents(buffer) == [
        (2, 2),
        (2, 3),
        (0, 2),
        (0, 3),
        (1, 0),
        (1, 1),
        (1, 2),
        (1, 3),
        (2, 0),
        (2, 1),
    ]


def test_minibatches_are_drawn_from_eligible_rows_only(monkeypatch):
    buffer = make(100, 16, monkeypatch)
    add(buffer, 0, 4, eligible=True)
    add(buffer, 1, 4, eligible=False)
    add(buffer, 2, 3, eligible=True)
    assert buffer.n_rows == 7
    assert [contents(buffer)[row][0] for row in np.asarray(buffer.rows)[:7]] == [0] * 4 + [2] * 3
