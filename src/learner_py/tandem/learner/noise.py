"""Normal numbers from a seed, the same in Python and in the policy runtime (noise.h): SplitMix64, then Box-Muller.

word i  = mix(seed + (i + 1) 0x9E3779B97F4A7C15)                        modulo 2^64
u1, u2  = ((word 2j >> 11) + 1) 2^-53,  (word 2j+1 >> 11) 2^-53        u1 in (0, 1], u2 in [0, 1)
numbers 2j, 2j+1 = sqrt(-2 ln u1) (cos, sin)(2 pi u2)                   in double, kept as float
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_GOLDEN_GAMMA = 0x9E3779B97F4A7C15


def seeded_noise(seed: int, n: int) -> NDArray[np.float32]:
    """The first n normal numbers (n,) of a seed in [0, 2^64)."""
    pairs = (n + 1) // 2
    steps = np.arange(1, 2 * pairs + 1, dtype=np.uint64)
    words = _mix(np.uint64(seed) + steps * np.uint64(_GOLDEN_GAMMA)) >> np.uint64(11)
    u1 = (words[0::2] + np.uint64(1)) * 2.0**-53
    u2 = words[1::2] * 2.0**-53
    radius, angle = np.sqrt(-2.0 * np.log(u1)), 2.0 * np.pi * u2
    numbers = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).reshape(-1)
    return numbers[:n].astype(np.float32)


def _mix(z: np.ndarray) -> np.ndarray:
    """SplitMix64's output function."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
