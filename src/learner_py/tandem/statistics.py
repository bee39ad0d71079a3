"""Statistics of success counts: the Wilson interval and what the tables need beside it."""

import math
from collections.abc import Sequence

Z_95 = 1.959963984540054  # two-sided 95 % quantile of the normal distribution


def wilson(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """Wilson score interval (low, high) of a success probability.

    Unlike the normal approximation it stays in [0, 1] and is honest at no and at all successes: 200 of 200
    gives (0.981, 1), 0 of 10 gives (0, 0.278). No trials: (0, 1), nothing is known.
    """
    if trials < 0 or not 0 <= successes <= max(trials, 0):
        raise ValueError(f"{successes} successes of {trials} trials is impossible")
    if trials == 0:
        return (0.0, 1.0)
    p = successes / trials
    denominator = 1.0 + z * z / trials
    centre = (p + z * z / (2.0 * trials)) / denominator
    half = z / denominator * math.sqrt(p * (1.0 - p) / trials + z * z / (4.0 * trials * trials))
    # The bound at the edge is exact; rounding must not move it by an ulp.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return (low, high)


def mean(values: Sequence[float]) -> float | None:
    """Mean, or None of nothing."""
    return sum(values) / len(values) if values else None


def share(part: float, whole: float) -> float:
    """part / whole, 0 of nothing."""
    return part / whole if whole else 0.0


def percent(successes: int, trials: int) -> str:
    """`98.5 % [95.7, 99.5] (197/200)`: share, 95 % Wilson interval, counts."""
    low, high = wilson(successes, trials)
    return (
        f"{100 * share(successes, trials):.1f} % [{100 * low:.1f}, {100 * high:.1f}] ({successes}/{trials})"
    )
