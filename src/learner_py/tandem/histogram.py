"""Distributions of durations as the controller and cyclictest write them: whole histograms that can be added up."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

SHARES = {"p50": 0.5, "p99": 0.99, "p999": 0.999}


@dataclass
class Histogram:
    """Counts by bucket: bucket i holds durations in [i, i + 1) bucket_us; `beyond` lie above all buckets."""

    bucket_us: float
    counts: Counter[int] = field(default_factory=Counter)
    beyond: int = 0
    max_us: float = 0.0

    @staticmethod
    def of_controller(value: Mapping[str, Any]) -> Histogram:
        """{bucket_us, counts: [...], max_us} of the controller's results; its last bucket holds all that is longer."""
        counts = value["counts"]
        return Histogram(
            bucket_us=value["bucket_us"],
            counts=Counter({i: n for i, n in enumerate(counts[:-1]) if n}),
            beyond=counts[-1] if counts else 0,
            max_us=value["max_us"],
        )

    @staticmethod
    def of_cyclictest(value: Mapping[str, Any]) -> Histogram:
        """cyclictest's --json, one thread, whole microseconds."""
        thread = value["thread"]["0"]
        counts = Counter({int(us): n for us, n in thread["histogram"].items() if n})
        return Histogram(
            bucket_us=1.0,
            counts=counts,
            beyond=max(0, thread["cycles"] - counts.total()),
            max_us=thread["max"],
        )

    @property
    def total(self) -> int:
        return self.counts.total() + self.beyond

    def percentiles(self) -> dict[str, float]:
        """p50, p99, p999 (upper edges of buckets; the maximum beyond them) and max, us."""
        found = {name: self._quantile(share) for name, share in SHARES.items()}
        return {**found, "max": self.max_us}

    def _quantile(self, share: float) -> float:
        wanted, seen = math.ceil(share * self.total), 0
        for bucket in sorted(self.counts):
            seen += self.counts[bucket]
            if seen >= wanted:
                return min(round((bucket + 1) * self.bucket_us, 6), self.max_us)
        return self.max_us


def added(histograms: Iterable[Histogram]) -> Histogram:
    """All of them as one. @raises ValueError when their buckets differ, or there is none."""
    parts = list(histograms)
    widths = {part.bucket_us for part in parts}
    if len(widths) != 1:
        raise ValueError(f"histograms with buckets of {sorted(widths)} us can't be added")
    sum_ = Histogram(widths.pop())
    for part in parts:
        sum_.counts.update(part.counts)
        sum_.beyond += part.beyond
        sum_.max_us = max(sum_.max_us, part.max_us)
    return sum_
