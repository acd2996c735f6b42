"""When reports that come in a fixed cycle were made, rid of the delays on their way.

A Pioneer's report carries no time of its own, and USB adapters hold bytes back for up to 16 ms
or hand over two reports at once.  Reports can be late but never early, and they are made every
SipCycle: the truth is the lower edge of receive time over number, as it is for `DeviceClock`.
Nothing here reads a clock.
"""

from __future__ import annotations

import math
from collections import deque

from slam.drivers.clock import Point, lower_edge

_REPORTS = 50  # that are remembered: 5 s of them
_LATE = 0.9  # cycles; a report that is later is taken for the next one, and this one for lost
_EARLY = 0.25  # cycles before its time: no report can be so early
_OFF_MAX = 0.3  # s per s; the cycle may differ so much from the one it should be
_GAP_NS = 2_000_000_000  # after such a gap the robot may have started again


class ReportCycle:
    """Feed it the receive time of every report, in order."""

    def __init__(self, cycle_ns: int = 100_000_000) -> None:
        """Expect a report every `cycle_ns`; ARCOS as delivered sends one every 100 ms."""
        if cycle_ns <= 0:
            raise ValueError("a cycle takes time")
        self._cycle_ns = cycle_ns
        self._last_ns = self._received_ns = 0
        self.restart()

    def restart(self, cycle_ns: int | None = None) -> None:
        """Forget the reports so far; from now on they may come in another cycle."""
        self._cycle_ns = cycle_ns or self._cycle_ns
        self._doubtful = 0  # reports that may have been late instead of lost
        self._points: deque[Point] = deque(maxlen=_REPORTS)  # (time by count, late by that)

    def stamp(self, received_ns: int, behind: int = 0) -> int:
        """Return when the report was sent that was received at `received_ns`, ns.

        `behind` reports have come in at the same moment, after it: a host that was busy finds
        several, and only the last of them can be new.

        Stamps rise strictly and are never later than the receipt, unless two reports were
        received at once.
        """
        silent_ns = received_ns - self._received_ns - behind * self._cycle_ns
        if self._points and silent_ns > _GAP_NS:
            self.restart()
        at = self._next(received_ns, behind)
        self._points.append((at, received_ns - at))
        self._received_ns = received_ns
        stamp = min(received_ns, self._edge(at))
        self._last_ns = max(stamp, self._last_ns + 1)
        return self._last_ns

    def _next(self, received_ns: int, behind: int) -> int:
        """Return the time by count of a report: one cycle on, or more if some were lost.

        Those that come right behind, before their time, were not lost but late.
        """
        if not self._points:
            return received_ns
        after = self._points[-1][0] + self._cycle_ns
        late = (received_ns - self._edge(after + behind * self._cycle_ns)) / self._cycle_ns
        if late >= _LATE:
            lost = math.floor(late + 1.0 - _LATE)
            self._doubtful += lost
        elif late < -_EARLY and self._doubtful:
            lost = -min(self._doubtful, math.ceil(-late - _EARLY))
            self._doubtful += lost
        else:
            lost = self._doubtful = 0
        return after + lost * self._cycle_ns

    def _edge(self, at: int) -> int:
        (level_at, level), slope = lower_edge(sorted(self._points), _OFF_MAX)
        return at + level + round(slope * (at - level_at))
