"""What is known of one channel: how many, how often, how regular, what is missing."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from tandem.spy.layout import FINGERPRINT_BYTES, Layout, of_fingerprint
from tandem.wire import CHANNELS

WINDOW_S = 2.0  # rate, jitter and bandwidth are of so long
SLOW = 10  # ... or of so many messages, when they come seldom
KEPT = 8192  # times kept for these figures
DECODED = (
    20  # messages of variable size decoded per call to judge them; the others are judged by their fingerprint
)
LATENCY_LIMIT_US = 60_000_000  # a larger one means that utime is on another clock


@dataclass(frozen=True)
class Row:
    """A channel's line in the table. None: not known, or does not apply."""

    channel: str
    type: str  # `?` when it is not ours
    count: int
    rate_hz: float | None
    expected_hz: float | None
    jitter_ms: float | None  # 99 % of the intervals differ from the median by no more
    gaps: int | None  # messages missing by their numbers
    bytes_per_s: float
    age_s: float  # since the last one
    latency_ms: dict[str, float] | None  # p50, p99, max from utime to receipt, when both are on one clock
    undecodable: int
    slow: bool  # comes less often than expected


class Channel:
    """Takes raw messages in batches; times in us on the source's clock."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.layout: Layout | None = None
        self.count = 0
        self.n_bytes = 0
        self.undecodable = 0
        self.latest: bytes | None = None  # the last one that decodes, as far as known
        self.raw: bytes | None = None  # the last one, whatever it is
        self._times = np.zeros(0, np.int64)
        self._sizes = np.zeros(0, np.int64)
        self._latencies = np.zeros(0, np.int64)
        self._last_us = 0
        self._gaps: _Gaps | None = None

    def take(
        self, times: list[int], data: list[bytes], decoded: int | None = DECODED, live: bool = False
    ) -> list[bytes]:
        """Counts messages; returns those that are what the channel carries.

        decoded: at most so many of variable size are decoded to judge them, None = all. live: utime and
        `times` may be on one clock, so that latency is told.
        """
        self.count += len(data)
        sizes = np.fromiter(map(len, data), np.int64, len(data))
        self.n_bytes += int(sizes.sum())
        arrived = np.array(times, np.int64)
        self._times = np.concatenate([self._times, arrived])[-KEPT:]
        self._sizes = np.concatenate([self._sizes, sizes])[-KEPT:]
        self._last_us, self.raw = times[-1], data[-1]
        good = self._good(data, decoded)
        self.undecodable += len(data) - len(good)
        if good and self.layout is not None:
            self.latest = good[-1]
            if self._gaps is not None:
                self._gaps.take(self.layout, good)
            if live and len(good) == len(data) and "utime" in self.layout.members:
                latency = arrived - self.layout.read("utime", good)
                self._latencies = np.concatenate([self._latencies, latency])[-KEPT:]
        return good

    def _good(self, data: list[bytes], decoded: int | None) -> list[bytes]:
        if self.layout is None:
            self.layout = self._find_layout(data)
            if self.layout is not None and self.layout.sequence is not None:
                self._gaps = _Gaps()
        layout = self.layout
        if layout is None:
            return []
        fingerprint = layout.message_type._get_packed_fingerprint()
        if layout.size is not None:
            size = layout.size
            return [d for d in data if len(d) >= size and d[:FINGERPRINT_BYTES] == fingerprint]
        head = max((offset + 8 for offset, _ in layout.members.values()), default=0)
        ours = [d for d in data if len(d) >= head and d[:FINGERPRINT_BYTES] == fingerprint]
        # the last ones: the very last is the one that is shown
        judged = len(ours) if decoded is None else decoded
        before = ours[: len(ours) - judged] if judged < len(ours) else []
        return before + [d for d in ours[len(before) :] if layout.decodes(d)]

    def _find_layout(self, data: list[bytes]) -> Layout | None:
        """By our name for the channel, else by what comes (a channel of ours with a suffix, for instance)."""
        known: Any = CHANNELS.get(self.name)
        if known is not None:
            return of_fingerprint(known._get_packed_fingerprint())
        return next((found for d in data if (found := of_fingerprint(d[:FINGERPRINT_BYTES]))), None)

    def decode_latest(self) -> Any | None:
        """The last message, decoded."""
        return None if self.layout is None or self.latest is None else self.layout.decode(self.latest)

    @property
    def gaps(self) -> int | None:
        """Messages missing by their numbers; None when they carry none."""
        return None if self._gaps is None else self._gaps.missing

    def row(self, now_us: int, expected_hz: float | None) -> Row:
        """The figures at a moment of the source's clock."""
        intervals, sizes, since_us = self._recent(now_us)
        rate = jitter = None
        if len(intervals):
            # a channel that has fallen silent slows down instead of keeping its last rate
            span = max(int(intervals.sum()), now_us - since_us - 2 * int(np.median(intervals)))
            rate = len(intervals) * 1e6 / span if span > 0 else None
            jitter = float(_quantiles(np.abs(intervals - np.median(intervals)), 0.99)[0]) / 1e3
        mean_size = float(sizes.mean()) if len(sizes) else 0.0
        return Row(
            channel=self.name,
            type=self.layout.name if self.layout else "?",
            count=self.count,
            rate_hz=rate,
            expected_hz=expected_hz,
            jitter_ms=jitter,
            gaps=self.gaps,
            bytes_per_s=mean_size * (rate or 0.0),
            age_s=max(0, now_us - self._last_us) / 1e6,
            latency_ms=self._latency(),
            undecodable=self.undecodable,
            slow=expected_hz is not None and (rate or 0.0) < 0.9 * expected_hz,
        )

    def _recent(self, now_us: int) -> tuple[np.ndarray, np.ndarray, int]:
        """Intervals and sizes in the window, and when the first of these messages came."""
        first = int(np.searchsorted(self._times, now_us - int(1e6 * WINDOW_S)))
        first = min(first, max(0, len(self._times) - SLOW))
        times = self._times[first:]
        return np.diff(times), self._sizes[first:], int(times[0]) if len(times) else now_us

    def _latency(self) -> dict[str, float] | None:
        seen = self._latencies
        if not len(seen) or seen.min() < 0 or seen.max() > LATENCY_LIMIT_US:
            return None
        p50, p99 = _quantiles(seen, 0.5, 0.99)
        return {"p50": p50 / 1e3, "p99": p99 / 1e3, "max": float(seen.max()) / 1e3}


def _quantiles(values: np.ndarray, *shares: float) -> list[float]:
    """The values at these shares of the order; a tenth of the time of np.quantile."""
    at = [min(len(values) - 1, int(share * len(values))) for share in shares]
    return np.partition(values, at)[at].tolist()


class _Gaps:
    """Messages missing by their numbers.

    Numbers may rise by 10 instead of 1 (ticks at 100 Hz): the usual step is what most messages so far had.
    A number that comes again or goes back (sent again) is no gap.
    """

    def __init__(self) -> None:
        self._steps: Counter[int] = Counter()
        self._last: tuple[int, int] | None = None  # group, number

    def take(self, layout: Layout, data: list[bytes]) -> None:
        sequence = layout.sequence
        assert sequence is not None
        numbers = layout.read(sequence.member, data)
        groups = layout.read(sequence.group, data) if sequence.group else np.zeros(len(data), np.int64)
        if self._last is not None:
            groups = np.concatenate([[self._last[0]], groups])
            numbers = np.concatenate([[self._last[1]], numbers])
        same = groups[1:] == groups[:-1]
        # what was sent again must not make the next new one look like a gap: the highest number so far counts
        stretch = np.concatenate([[0], np.cumsum(~same)]) << 44
        highest = np.maximum.accumulate(np.clip(numbers, 0, 1 << 43) + stretch) - stretch
        steps = np.diff(highest)[same & (groups[1:] >= 0)]
        forward, n = np.unique(steps[steps > 0], return_counts=True)
        self._steps.update(dict(zip(forward.tolist(), n.tolist(), strict=True)))
        if len(self._steps) > 1000:  # hostile or broken numbers must not fill the memory
            self._steps = Counter(dict(self._steps.most_common(100)))
        self._last = (int(groups[-1]), int(highest[-1]))

    @property
    def missing(self) -> int:
        if not self._steps:
            return 0
        usual = self._steps.most_common(1)[0][0]
        return sum(n * (round(step / usual) - 1) for step, n in self._steps.items() if step > usual)
