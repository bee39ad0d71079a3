"""Held keys from a terminal that tells only of presses and repeats the last one: smooth, diagonal, and over in time."""

import random
from collections.abc import Iterator

import pytest

from tandem.teleop.held_keys import LONGEST_DELAY_S, Direction, ExactKeys, RepeatedKeys

W, S, A, D = Direction(0, 1), Direction(0, -1), Direction(1, 1), Direction(1, -1)
TERMINALS = [
    (0.66, 0.04),
    (0.25, 0.033),
    (0.375, 0.09),
    (0.5, 0.033),
]  # s: delay to the first repeat, then interval


def repeats(terminal: tuple[float, float], since: float, until: float) -> Iterator[float]:
    """Times at which a terminal sends a key that is held from `since` to `until`."""
    delay, interval = terminal
    yield since
    at = since + delay
    while at < until:
        yield at
        at += interval


def play(
    keys: RepeatedKeys, events: list[tuple[float, Direction]], until: float
) -> dict[float, frozenset[Direction]]:
    """What counts as held every 10 ms."""
    held, events = {}, sorted(events)
    for i in range(round(until / 0.01)):
        now = 0.01 * i
        while events and events[0][0] <= now:
            at, direction = events.pop(0)
            keys.press(direction, at)
        held[round(now, 2)] = keys.held(now)
    return held


@pytest.mark.parametrize("terminal", TERMINALS)
def test_a_held_key_stays_held_and_ends_soon_after_its_release(terminal: tuple[float, float]) -> None:
    held = play(RepeatedKeys(), [(at, W) for at in repeats(terminal, 0.0, 3.0)], 4.0)
    assert all(held[t] == {W} for t in held if terminal[0] + 0.01 < t < 2.9)
    assert all(not held[t] for t in held if t > 3.3)


def test_a_tap_is_short() -> None:
    held = play(RepeatedKeys(), [(0.0, W)], 2.0)
    assert sum(bool(keys) for keys in held.values()) <= 13  # of 10 ms


@pytest.mark.parametrize("terminal", TERMINALS)
def test_two_keys_pressed_together_make_a_diagonal(terminal: tuple[float, float]) -> None:
    events = [(0.0, W), *((at, A) for at in repeats(terminal, 0.03, 2.0))]  # only the last key is repeated
    held = play(RepeatedKeys(), events, 3.0)
    assert all(held[t] == {W, A} for t in held if 0.03 + terminal[0] + 0.01 < t < 1.9)
    assert all(not held[t] for t in held if t > 2.3)


@pytest.mark.parametrize("terminal", TERMINALS)
def test_a_second_key_joins_a_held_one_without_a_stutter(terminal: tuple[float, float]) -> None:
    events = [(at, W) for at in repeats(terminal, 0.0, 2.0)] + [(at, A) for at in repeats(terminal, 2.0, 4.0)]
    held = play(RepeatedKeys(), events, 5.0)
    assert all(held[t] == {W, A} for t in held if 2.0 <= t < 3.9)
    assert all(not held[t] for t in held if t > 4.3)


def test_keys_tapped_one_after_the_other_do_not_move_together() -> None:
    held = play(RepeatedKeys(), [(0.0, W), *((at, A) for at in repeats((0.5, 0.03), 0.4, 2.0))], 3.0)
    assert all(W not in held[t] for t in held if t > 0.2)
    assert held[1.5] == {A}


def test_the_opposite_key_takes_its_opposites_place() -> None:
    keys = RepeatedKeys()
    events = [(at, W) for at in repeats((0.3, 0.03), 0.0, 1.0)] + [(1.0, S)]
    play(keys, events, 1.01)
    assert keys.held(1.01) == {S}


def test_space_stops_all_until_the_next_repeat_and_a_blur_forgets() -> None:
    keys = RepeatedKeys()
    play(keys, [(at, W) for at in repeats((0.3, 0.03), 0.0, 1.0)], 1.0)
    keys.clear()
    assert not keys.held(1.0)
    exact = ExactKeys()
    exact.press(W, 0.0)
    exact.press(A, 0.0)
    exact.release(W)
    assert exact.held(100.0) == {A}
    exact.clear()
    assert not exact.held(100.0)


def test_whatever_is_typed_nothing_is_held_for_long_after_the_last_event() -> None:
    draw = random.Random(11)
    for _ in range(2000):
        keys, now = RepeatedKeys(), 0.0
        for _ in range(draw.randrange(1, 40)):
            now += draw.choice([0.001, 0.03, 0.09, 0.2, 0.5, 1.0]) * draw.uniform(0.5, 1.5)
            keys.press(draw.choice([W, S, A, D]), now)
            held = keys.held(now)
            assert held and not any(direction.opposite in held for direction in held)
        assert not keys.held(now + 1.3 * LONGEST_DELAY_S + 0.01)
