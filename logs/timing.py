"""When the messages of a channel came: rate, gaps, order.

A period is the time from one stamp to the next.  A gap is a period of at least five times
the channel's median and half a second; only the longest few are kept by place.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

from slam.logs.sampled import Sampled

GAP_PERIODS = 5.0
GAP_LEAST_S = 0.5
_GAPS_KEPT = 64


@dataclass(frozen=True, slots=True)
class Gap:
    """A time without messages."""

    start_ns: int  # stamp of the last message before it
    seconds: float


@dataclass(frozen=True, slots=True)
class Timing:
    """Rates and order of one channel's stamps."""

    messages: int
    first_ns: int  # earliest stamp
    last_ns: int  # latest stamp
    rate_hz: float  # from the median period; nan if unknown
    mean_rate_hz: float  # over the whole duration, gaps included
    longest_s: float  # longest period
    gaps: tuple[Gap, ...]  # the longest ones, in order of time
    more_gaps: bool  # whether there were more than are kept
    backwards: int  # stamps earlier than the one before
    farthest_back_s: float
    duplicates: int  # stamps equal to the one before

    @property
    def duration_s(self) -> float:
        """From the earliest stamp to the latest."""
        return (self.last_ns - self.first_ns) * 1e-9


class TimingCounter:
    """Takes in the stamps of one channel, in file order."""

    def __init__(self) -> None:
        self.count = 0
        self._first = self._last = self._previous = 0
        self._periods = Sampled()
        self._longest: list[tuple[float, int]] = []  # heap of the longest periods (s, start)
        self._backwards = self._duplicates = 0
        self._farthest_back_s = 0.0

    def add(self, stamp_ns: int) -> None:
        """Take in one stamp."""
        if self.count == 0:
            self._first = self._last = stamp_ns
        else:
            self._compare((stamp_ns - self._previous) * 1e-9)
            self._first, self._last = min(self._first, stamp_ns), max(self._last, stamp_ns)
        self._previous = stamp_ns
        self.count += 1

    def _compare(self, period_s: float) -> None:
        if period_s == 0.0:
            self._duplicates += 1
        elif period_s < 0.0:
            self._backwards += 1
            self._farthest_back_s = max(self._farthest_back_s, -period_s)
        else:
            self._periods.add(period_s)
            if period_s >= GAP_LEAST_S:
                entry = (period_s, self._previous)
                if len(self._longest) < _GAPS_KEPT:
                    heapq.heappush(self._longest, entry)
                else:
                    heapq.heappushpop(self._longest, entry)

    def result(self) -> Timing:
        """Return what the stamps say."""
        median = self._periods.median
        duration = (self._last - self._first) * 1e-9
        limit = max(GAP_LEAST_S, GAP_PERIODS * median)
        gaps = sorted((Gap(at, s) for s, at in self._longest if s >= limit), key=_start)
        return Timing(
            self.count,
            self._first,
            self._last,
            1.0 / median if median > 0 else math.nan,
            (self.count - 1) / duration if duration > 0 else math.nan,
            max(self._periods.most, 0.0),
            tuple(gaps),
            len(gaps) == _GAPS_KEPT,
            self._backwards,
            self._farthest_back_s,
            self._duplicates,
        )


def _start(gap: Gap) -> int:
    return gap.start_ns
