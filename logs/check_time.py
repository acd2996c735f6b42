"""Checks of stamps: rates, gaps, order, unset clocks, and drift against the time of receipt."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from slam.logs.findings import Finding, seconds
from slam.logs.sampled import Sampled
from slam.logs.timing import Timing, TimingCounter

YEAR_2000_NS = 946_684_800 * 10**9
MINUTES_S = 60.0  # after such a gap the robot may stand somewhere else
DRIFT_PPM = 100.0  # crystals are good to 50 ppm; 100 ppm are 0.36 s in an hour
DRIFT_LEAST_S = 60.0  # no drift is judged over less time
LATE_S = 0.5
EARLY_S = 0.01  # by less a scan at full speed is a centimetre off
STEP_S = 0.25  # of the clock, between two windows
SLOW_SCAN_HZ = 1.0

_WINDOWS = 1024  # kept at most; their width doubles when there are more
_WINDOW_S = 1.0


class StampCheck:
    """Stamps of one channel, in file order."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._timing = TimingCounter()
        self._before_2000 = 0

    @property
    def empty(self) -> bool:
        """Whether there was no stamp."""
        return self._timing.count == 0

    def feed(self, stamp_ns: int) -> None:
        """Take in one stamp."""
        self._timing.add(stamp_ns)
        self._before_2000 += stamp_ns < YEAR_2000_NS

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        timing = self._timing.result()
        yield from self._order(timing)
        yield from self._clock(timing)
        name = self.topic.strip("/").replace("/", "-")
        if timing.gaps:
            worst = max(timing.gaps, key=lambda gap: gap.seconds)
            least = "at least " if timing.more_gaps else ""
            more = "; the robot may have been moved" if worst.seconds >= MINUTES_S else ""
            yield Finding(
                "warning", f"{name}-gap", self.topic,
                f"{least}{len(timing.gaps)} gaps in the messages, the longest "
                f"{seconds(worst.seconds)} (median period {seconds(1 / timing.rate_hz)}){more}",
                len(timing.gaps), worst.start_ns,
            )  # fmt: skip
        if self.topic == "/scan" and timing.rate_hz < SLOW_SCAN_HZ:
            yield Finding(
                "note", "scan-rate", self.topic,
                f"only {timing.rate_hz:.2f} scans a second: every scan may have to be a keyframe",
            )  # fmt: skip

    def _order(self, timing: Timing) -> Iterator[Finding]:
        if timing.backwards:
            yield Finding(
                "warning", "stamps-backwards", self.topic,
                f"{timing.backwards} stamps run backwards, by up to "
                f"{seconds(timing.farthest_back_s)}: replay skips such messages",
                timing.backwards,
            )  # fmt: skip
        if timing.duplicates:
            yield Finding(
                "warning", "stamps-duplicate", self.topic,
                f"{timing.duplicates} messages have the stamp of the one before: "
                "replay uses the first of such scans",
                timing.duplicates,
            )  # fmt: skip

    def _clock(self, timing: Timing) -> Iterator[Finding]:
        if self._before_2000 == timing.messages:
            yield Finding(
                "note", "clock-unset", self.topic,
                "every stamp is before the year 2000: simulated time, or a clock that was not "
                "set, which does no harm while it runs evenly",
                self._before_2000, timing.first_ns,
            )  # fmt: skip
        elif self._before_2000:
            yield Finding(
                "error", "clock-set-late", self.topic,
                f"{self._before_2000} of {timing.messages} stamps are from before the year 2000: "
                "the clock was set during the recording; cut the log there",
                self._before_2000, timing.first_ns,
            )  # fmt: skip


class ReceiptCheck:
    """Time of receipt against stamp: a device's clock that drifts, steps, or runs ahead.

    Delays only ever add to the time of receipt, so the least delay of each window tells
    the clocks apart; a line through these gives the drift.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._delays = Sampled()
        self._window_s = _WINDOW_S
        self._origin_ns: int | None = None
        self._least: dict[int, float] = {}  # s, by number of the window
        self._simulated = False  # stamps of a simulation beside receipts of today

    def feed(self, receipt_ns: int, stamp_ns: int) -> None:
        """Take in one message's times."""
        if self._origin_ns is None:
            self._origin_ns = receipt_ns
        self._simulated = stamp_ns < YEAR_2000_NS <= receipt_ns
        delay_s = (receipt_ns - stamp_ns) * 1e-9
        self._delays.add(delay_s)
        window = int((receipt_ns - self._origin_ns) * 1e-9 // self._window_s)
        self._least[window] = min(self._least.get(window, math.inf), delay_s)
        if len(self._least) > _WINDOWS:
            self._widen()

    def _widen(self) -> None:
        wider: dict[int, float] = {}
        for window, delay in self._least.items():
            wider[window // 2] = min(wider.get(window // 2, math.inf), delay)
        self._least, self._window_s = wider, 2 * self._window_s

    def drift_ppm(self) -> float:
        """Return how much faster the receiving clock runs; nan if too little is known."""
        windows = np.array(sorted(self._least), dtype=np.float64)
        if (
            self._simulated
            or len(windows) < 3
            or (windows[-1] - windows[0]) * self._window_s < DRIFT_LEAST_S
        ):
            return math.nan
        delays = np.array([self._least[int(w)] for w in windows])
        centred = windows - windows.mean()
        slope = float(centred @ (delays - delays.mean())) / float(centred @ centred)
        return 1e6 * slope / self._window_s

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd; nothing for a log without times of receipt of its own."""
        if self._delays.least == self._delays.most == 0.0 or self._simulated:
            return
        steps = [
            abs(self._least[b] - self._least[a])
            for a, b in zip(sorted(self._least), sorted(self._least)[1:], strict=False)
        ]
        stepped = sum(step > STEP_S for step in steps)
        if stepped:
            yield Finding(
                "warning", "clock-step", self.topic,
                f"stamps and times of receipt jump against each other {stepped} times, "
                f"by up to {seconds(max(steps))}", stepped,
            )  # fmt: skip
        drift = self.drift_ppm()
        if not stepped and abs(drift) > DRIFT_PPM:
            yield Finding(
                "warning", "clock-drift", self.topic,
                f"the device's clock drifts by {drift:.0f} ppm against the time of receipt "
                f"({abs(drift) * 3.6e-3:.2g} s in an hour)",
            )  # fmt: skip
        if self._delays.median > LATE_S:
            yield Finding(
                "warning", "late", self.topic,
                f"messages are received {seconds(self._delays.median)} after their stamp",
            )  # fmt: skip
        if self._delays.least < -EARLY_S:
            yield Finding(
                "warning", "early", self.topic,
                f"messages are received up to {seconds(-self._delays.least)} before their stamp: "
                "the clocks do not agree",
            )  # fmt: skip
