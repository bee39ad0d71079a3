"""Which directions are held down, from key events.

A terminal with the kitty protocol tells of every release: `ExactKeys`. Any other tells only of presses, and repeats
the key that was pressed last; `RepeatedKeys` makes the best of that.
"""

import math
from typing import NamedTuple, Protocol


class Direction(NamedTuple):
    """One way along one axis of device_twist: axis 0 to 5, sign -1 or 1."""

    axis: int
    sign: int

    @property
    def opposite(self) -> "Direction":
        return Direction(self.axis, -self.sign)


class HeldKeys(Protocol):
    """Times are seconds on the monotonic clock."""

    def press(self, direction: Direction, now: float) -> None:
        """A press, or a repeat."""

    def release(self, direction: Direction) -> None: ...

    def clear(self) -> None:
        """Nothing is held any more, whatever the fingers do, until the next event."""

    def held(self, now: float) -> frozenset[Direction]: ...


class ExactKeys:
    """Presses and releases as they are."""

    def __init__(self) -> None:
        self._held: set[Direction] = set()

    def press(self, direction: Direction, now: float) -> None:
        self._held.add(direction)

    def release(self, direction: Direction) -> None:
        self._held.discard(direction)

    def clear(self) -> None:
        self._held.clear()

    def held(self, now: float) -> frozenset[Direction]:
        return frozenset(self._held)


TAP_S = 0.12  # a key that was heard once counts as held so long; keys pressed within this belong together
FIRST_DELAY_S = 0.5  # until a terminal begins to repeat, before we have seen it do so
LONGEST_DELAY_S = 0.9  # a repeat that comes later is a new press
LONGEST_INTERVAL_S = 0.15  # between two repeats, slowest terminal


class RepeatedKeys:
    """Keys pressed together are a group: the whole group counts as held while the terminal repeats any of it.

    That makes diagonals, though only the key pressed last is repeated. When a key joins a group that is being
    repeated, the group stays held until that key's own repeats begin, for as long as this terminal has been seen to
    take. The opposite key takes its opposite's place. The price: of two held keys, letting go of the one pressed last
    stops both; letting go of the other one is not seen.
    """

    def __init__(self) -> None:
        self._interval = LONGEST_INTERVAL_S / 2  # s between repeats, as measured
        self._delay = FIRST_DELAY_S  # s from press to first repeat, as measured
        self.clear()

    def clear(self) -> None:
        self._group: frozenset[Direction] = frozenset()
        self._last: Direction | None = None
        self._heard = -math.inf  # the last event
        self._until = -math.inf  # the group counts as held until then,
        self._wakes_until = -math.inf  # and again when one of it is repeated before then
        self._repeats = 0  # of the key pressed last
        self._first_gap = 0.0

    def press(self, direction: Direction, now: float) -> None:
        if direction in self._group and now < self._wakes_until:
            self._repeat(direction, now)
        elif now < self._until:
            self._join(direction, now)
        else:
            self._group, self._repeats = frozenset({direction}), 0
            self._until, self._wakes_until = now + TAP_S, now + LONGEST_DELAY_S
        self._last, self._heard = direction, now

    def release(self, direction: Direction) -> None:
        """Never told."""

    def held(self, now: float) -> frozenset[Direction]:
        return self._group if now < self._until else frozenset()

    def _repeat(self, direction: Direction, now: float) -> None:
        gap = now - self._heard
        if direction == self._last:
            if self._repeats == 0:
                self._first_gap = gap
            elif gap < LONGEST_INTERVAL_S:
                self._interval += 0.3 * (gap - self._interval)
                if (
                    self._repeats == 1
                ):  # two in a row: the gap before them was the terminal's delay, not a second tap
                    self._delay = min(max(self._first_gap, TAP_S), LONGEST_DELAY_S)
            self._repeats += 1
        self._until = self._wakes_until = now + max(3 * self._interval, 0.08)

    def _join(self, direction: Direction, now: float) -> None:
        self._group = self._group - {direction.opposite} | {direction}
        wait = 1.3 * self._delay if self._repeats > 1 else TAP_S
        self._until = max(self._until, now + wait)
        self._wakes_until = now + LONGEST_DELAY_S
        self._repeats = 0
