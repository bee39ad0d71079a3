"""Seeded noise is the very numbers that the policy runtime draws."""

from __future__ import annotations

import math

import numpy as np

from tandem.learner.noise import seeded_noise

MASK = 2**64 - 1


def word(seed: int, i: int) -> int:
    """SplitMix64 with Python's integers."""
    z = (seed + (i + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


def test_words_are_splitmix64():
    # the first outputs for seed 1234567 that are published with the algorithm
    assert [word(1234567, i) for i in range(3)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
    ]


def test_numbers_are_box_muller_of_the_words():
    for seed in (0, 7, 1234567, 2**64 - 1):
        expected = []
        for j in range(4):
            u1, u2 = ((word(seed, 2 * j) >> 11) + 1) / 2**53, (word(seed, 2 * j + 1) >> 11) / 2**53
            radius = math.sqrt(-2 * math.log(u1))
            expected += [radius * math.cos(2 * math.pi * u2), radius * math.sin(2 * math.pi * u2)]
        np.testing.assert_allclose(seeded_noise(seed, 8), expected, rtol=0, atol=1e-6)


def test_known_numbers_of_seed_0():
    known = [-0.45275775, 0.20776604, 2.650606, -0.49042282, -0.9886041]
    numbers = seeded_noise(0, 5)
    assert numbers.dtype == np.float32
    np.testing.assert_allclose(numbers, known, rtol=0, atol=1e-6)


def test_fewer_numbers_are_the_beginning_of_more():
    np.testing.assert_array_equal(seeded_noise(3, 7), seeded_noise(3, 100)[:7])
    assert seeded_noise(3, 0).shape == (0,)


def test_numbers_are_standard_normal():
    numbers = seeded_noise(11, 100_000)
    assert abs(numbers.mean()) < 0.01 and abs(numbers.std() - 1) < 0.01
    assert np.isfinite(numbers).all()
