"""Smooth motion: bounded rates, small nudges, no step at a dead zone's edge."""

import itertools
import random

import pytest

from tandem.teleop.held_keys import TAP_S, Direction
from tandem.teleop.keyboard import FALL_S, RISE_S
from tandem.teleop.motion import Ramp, deflection, wanted

DT = 0.02
FULL_M_S = 0.12  # peg: 12 mm a step of 0.1 s


def test_a_tap_nudges_by_about_a_millimetre_and_a_held_key_reaches_full_speed() -> None:
    ramp, moved = Ramp(RISE_S, FALL_S), 0.0
    for i in range(50):
        twist = ramp.step(wanted([Direction(0, 1)] if i * DT < TAP_S else []), DT)
        moved += 0.5 * FULL_M_S * twist[0] * DT  # at the speed that it starts with
    assert 0.0003 < moved < 0.003
    assert ramp.value == [0.0] * 6
    for _ in range(round(RISE_S / DT) + 1):
        ramp.step(wanted([Direction(0, 1), Direction(1, -1)]), DT)
    assert ramp.value[:2] == [1.0, -1.0]


def test_the_ramp_never_exceeds_its_rates_and_stays_in_range() -> None:
    draw = random.Random(3)
    ramp = Ramp(RISE_S, FALL_S)
    for _ in range(20_000):
        before = list(ramp.value)
        goal = [draw.choice([-1.0, 0.0, 0.3, 1.0]) for _ in range(6)] if draw.random() < 0.1 else before
        for old, new in zip(before, ramp.step(goal, DT), strict=True):
            assert abs(new) <= 1.0
            assert abs(new - old) <= (DT / RISE_S if abs(new) > abs(old) else DT / FALL_S) + 1e-12


@pytest.mark.parametrize("dead_zone", [0.0, 0.12, 0.3])
def test_a_stick_is_quiet_in_its_dead_zone_monotone_and_full_at_its_end(dead_zone: float) -> None:
    values = [deflection(i / 1000, dead_zone) for i in range(-1000, 1001)]
    assert values[0] == -1.0 and values[-1] == 1.0 and values[1000] == 0.0
    assert all(0.0 <= b - a < 0.005 for a, b in itertools.pairwise(values))
    assert all(v == 0.0 for i, v in enumerate(values) if abs(i - 1000) <= 1000 * dead_zone)
    assert deflection(7.0, dead_zone) == 1.0 and deflection(float("nan"), dead_zone) == 0.0


def test_opposite_keys_cancel() -> None:
    assert wanted([Direction(0, 1), Direction(0, -1), Direction(5, -1)]) == [0, 0, 0, 0, 0, -1]
