"""Device time to host time: offset, drift and wrap of a sensor's millisecond counter.

Bytes can be late but never early, so the truth lies along the lower edge of
`receive time - device time`, whatever jitter USB adds.  How far that edge lies above the
true offset (sweep and transmission) is measured once, against the round trips of TM1.
Nothing here reads a clock: every time is an argument, in ns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

Point = tuple[int, int]  # device time and offset, ns


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockConfig:
    """How the clock of a sensor is followed."""

    tick_ns: int = 1_000_000  # ns a count lasts; SCIP counts milliseconds
    wrap: int = 1 << 24  # counts until it starts again at 0 (docs/devices.md, section 4.3)
    bin_s: float = 1.0  # s, the quickest of each such span stands for it
    bins: int = 60  # spans remembered: a minute shows 1 ms of jitter as 17 ppm at worst
    settle_s: float = 10.0  # s of device time until the lag is known
    drift_max: float = 500e-6  # s per s; a quartz is good to 50e-6
    early_s: float = 0.02  # s before its time: no reading can be that quick
    strange_s: float = 5.0  # s off: the counter was damaged on the way or started again
    strange_runs: int = 3  # so many in a row: it did start again
    lag_max_s: float = 2.0  # s; a TM offset that implies more is not believed (section 6)

    def __post_init__(self) -> None:
        """Refuse a clock that stands still."""
        if min(self.tick_ns, self.wrap, self.bins) <= 0 or min(self.bin_s, self.drift_max) <= 0:
            raise ValueError("tick, wrap, bins, bin_s and drift_max must be positive")


class DeviceClock:
    """Follows one counter; feed it every stamped reading in the order of receipt."""

    def __init__(self, config: ClockConfig | None = None) -> None:
        self.restarts = 0
        self.refused = 0
        self.distrusted_syncs = 0
        self._config = config or ClockConfig()
        self._reset()

    @property
    def drift(self) -> float:
        """Seconds that the host gains per second of device time, 0 until it is known."""
        return self._slope

    @property
    def offset_s(self) -> float | None:
        """Host time minus device time in s by the quickest round trip, None if there was none."""
        return None if self._anchor is None else self._anchor * 1e-9

    @property
    def synchronised(self) -> bool:
        """Whether a round trip has been measured since the last restart."""
        return self._anchor is not None

    def restart(self) -> None:
        """Forget everything: the counter has begun again or was set."""
        self.restarts += 1
        self._reset()

    def _reset(self) -> None:
        self._last: tuple[int, int] | None = None  # count without wraps, receive time
        self._seen: int | None = None  # device time of the last reading, ns
        self._anchor: int | None = None  # host - device, ns, by the quickest round trip
        self._trip = math.inf
        self._lag: int | None = None  # ns from the true offset up to the lower edge
        self._first: int | None = None  # device time of the first reading
        self._floor = 0  # smallest offset since then
        self._bins: list[Point] = []
        self._current: Point | None = None
        self._level: Point | None = None  # a point of the lower edge
        self._slope = 0.0
        self._strange = 0

    def synchronise(self, count: int, sent_ns: int, received_ns: int) -> None:
        """Take the answer to "what time is it?", asked and answered at host times."""
        device = self._unwrapped(count, received_ns)
        self._last = (device // self._config.tick_ns, received_ns)
        if received_ns - sent_ns < self._trip:
            self._trip = received_ns - sent_ns
            self._anchor = (sent_ns + received_ns) // 2 - device

    def observe(self, count: int, received_ns: int, assumed_lag_ns: int = 0) -> int | None:
        """Return the host time of counter value `count`, which was received at `received_ns`.

        `assumed_lag_ns` is the least delay of a reading; it serves where no round trip was
        measured.  None if the counter cannot be right; after some of these in a row, the
        counter is taken to have started again.
        """
        device = self._unwrapped(count, received_ns)
        if self._is_strange(device, received_ns):
            return None
        self._last = (device // self._config.tick_ns, received_ns)
        self._seen = device
        offset = received_ns - device
        self._remember(device, offset)
        if self._lag is None:
            return device + self._unsettled(device, assumed_lag_ns)
        return device + self._edge(device) - self._lag

    def _unwrapped(self, count: int, received_ns: int) -> int:
        """Return device time (ns, middle of the count) with the wraps that fit the host's time."""
        tick, wrap = self._config.tick_ns, self._config.wrap
        if self._last is not None:
            expected = self._last[0] + (received_ns - self._last[1]) / tick
            count += round((expected - count) / wrap) * wrap
        return count * tick + tick // 2

    def _is_strange(self, device: int, received_ns: int) -> bool:
        if self._last is None:
            return False
        config = self._config
        passed = device - self._last[0] * config.tick_ns - (received_ns - self._last[1])
        early = self._level is not None and (
            received_ns - device < self._edge(device) - config.early_s * 1e9
        )
        back = self._seen is not None and device < self._seen - config.tick_ns
        if abs(passed) <= config.strange_s * 1e9 and not early and not back:
            self._strange = 0
            return False
        self.refused += 1
        self._strange += 1
        if self._strange >= config.strange_runs:
            self.restart()
        return True

    def _remember(self, device: int, offset: int) -> None:
        """Keep the quickest reading of each bin; a full bin moves the lower edge."""
        if self._first is None:
            self._first, self._floor = device, offset
        self._floor = min(self._floor, offset)
        if self._current is None:
            self._current = (device, offset)
        elif device // self._span == self._current[0] // self._span:
            self._current = min(self._current, (device, offset), key=lambda point: point[1])
        else:
            self._bins = [*self._bins, self._current][-self._config.bins :]
            self._current = (device, offset)
            if self._lag is not None:
                self._level, self._slope = lower_edge(self._bins, self._config.drift_max)

    @property
    def _span(self) -> int:
        return round(self._config.bin_s * 1e9)

    def _unsettled(self, device: int, assumed_lag_ns: int) -> int:
        """Return the offset while the lag is being measured; fix it when the time has come."""
        lag = self._floor - self._anchor if self._anchor is not None else assumed_lag_ns
        if not -2 * self._config.tick_ns <= lag <= self._config.lag_max_s * 1e9:
            self.distrusted_syncs += 1
            self._anchor, lag = None, assumed_lag_ns
        lag = max(lag, assumed_lag_ns)  # a slow answer puts the anchor too late
        if self._first is not None and device - self._first >= self._config.settle_s * 1e9:
            self._level, self._slope = lower_edge(self._bins, self._config.drift_max)
            if self._anchor is not None:  # against the edge back then: it has drifted since
                lag = max(self._edge(self._first) - self._anchor, assumed_lag_ns)
            self._lag = lag
        return self._floor - lag

    def _edge(self, device: int) -> int:
        """Return the lower edge of the offsets at a device time, ns."""
        if self._level is None:
            return self._floor
        at, offset = self._level
        return offset + round(self._slope * (device - at))


def lower_edge(points: list[Point], slope_max: float) -> tuple[Point, float]:
    """Return the line (a point and its slope) below all points that is nearest to them.

    It is the edge of the lower convex hull under the mean abscissa (Moon, Skelly and
    Towsley 1999).  A slope that no quartz has is refused for a level line at the minimum.
    `points` are in order of the first coordinate and not empty.
    """
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    middle = sum(at for at, _ in points) // len(points)
    for (x1, y1), (x2, y2) in pairwise(hull):
        if x1 <= middle <= x2 and x1 < x2:
            slope = (y2 - y1) / (x2 - x1)
            if abs(slope) <= slope_max:
                return (x1, y1), slope
    return min(points, key=lambda point: point[1]), 0.0


def _turns_down(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])
