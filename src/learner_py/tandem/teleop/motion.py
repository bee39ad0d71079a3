"""From what is pushed to a smooth twist."""

import math
from collections.abc import Iterable, Sequence

from tandem.teleop.held_keys import Direction

AXES = 6  # translation x y z, rotation x y z

SLOWEST, FASTEST = 0.05, 1.0  # share of the task's limit per step
SPEED_STEP = 1.25


def wanted(directions: Iterable[Direction]) -> list[float]:
    """Held directions as a twist of -1, 0 and 1; opposites cancel."""
    twist = [0.0] * AXES
    for axis, sign in directions:
        twist[axis] = min(1.0, max(-1.0, twist[axis] + sign))
    return twist


def deflection(raw: float, dead_zone: float) -> float:
    """A stick's position [-1, 1] -> [-1, 1]: 0 within the dead zone, without a step at its edge, gentle at first."""
    beyond = (min(abs(raw), 1.0) - dead_zone) / (1.0 - dead_zone)
    if not beyond > 0.0:
        return 0.0
    return math.copysign(0.5 * beyond + 0.5 * beyond**3, raw)


class Ramp:
    """Follows a wanted twist with bounded rates: away from standstill in `rise_s` for a full swing, back in `fall_s`.

    A tap of a key ends before it has come far: a small nudge. A held key reaches full speed.
    """

    def __init__(self, rise_s: float, fall_s: float) -> None:
        self._rise, self._fall = 1.0 / rise_s, 1.0 / fall_s  # 1/s
        self.value = [0.0] * AXES

    def stop(self) -> None:
        """At once."""
        self.value = [0.0] * AXES

    def step(self, twist: Sequence[float], dt: float) -> list[float]:
        """One period of `dt` s towards `twist`. Returns the new value."""
        self.value = [self._axis(now, goal, dt) for now, goal in zip(self.value, twist, strict=True)]
        return self.value

    def _axis(self, now: float, goal: float, dt: float) -> float:
        if now * goal < 0.0:  # a reversal stops first
            goal = 0.0
        rate = (self._rise if abs(goal) > abs(now) else self._fall) * dt
        return now + min(rate, max(-rate, goal - now))
