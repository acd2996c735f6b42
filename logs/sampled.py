"""A bounded, evenly spread sample of an endless stream of numbers."""

from __future__ import annotations

import math

_LIMIT = 4096


class Sampled:
    """Keeps every number while there are few, then every second, every fourth, ...

    A median over it is exact for short streams and close for long ones, and equal streams
    give equal results.
    """

    def __init__(self, limit: int = _LIMIT) -> None:
        """Keep fewer than `limit` numbers, an even one."""
        self._limit = limit
        self.count = 0
        self.least, self.most = math.inf, -math.inf
        self._kept: list[float] = []
        self._stride = 1

    def add(self, value: float) -> None:
        """Take in one number."""
        if self.count % self._stride == 0:
            if len(self._kept) == self._limit:
                del self._kept[1::2]
                self._stride *= 2
            if self.count % self._stride == 0:
                self._kept.append(value)
        self.count += 1
        self.least, self.most = min(self.least, value), max(self.most, value)

    def quantile(self, share: float) -> float:
        """Return the value below which a share (0 to 1) of the numbers lies, nan if none."""
        if not self._kept:
            return math.nan
        ordered = sorted(self._kept)
        return ordered[min(int(share * len(ordered)), len(ordered) - 1)]

    @property
    def median(self) -> float:
        """The middle value, nan if there is none."""
        return self.quantile(0.5)
