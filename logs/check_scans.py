"""Checks of scans: geometry, ranges, and a laser that sees nothing or always the same."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from slam.logs.check_geometry import GeometryCheck
from slam.logs.findings import Finding, Severity, seconds
from slam.logs.messages import LaserScan
from slam.logs.sampled import Sampled

NAN_SHARE = 0.5  # of all beams: more of them unusable is a defect or a wrong import
BLIND_SHARE = 0.05  # of beams that bring something back; below it a scan is blind
FROZEN_SCANS = 5  # so many equal scans in a row: noise alone makes that impossible
STANDS = 0.05  # m or rad by the odometry: a robot that moved less may see the same again
_SAMPLES = 256  # enough for a median
SWEEP_SHARE = 0.2  # of the time between scans: a sweep of a shorter time is stated wrongly


class ScanCheck:
    """Scans of one channel, in file order."""

    def __init__(self, topic: str = "/scan") -> None:
        self.topic = topic
        self._scans = self._beams = self._nan = self._far = self._near = 0
        self._blind = self._impossible = 0
        self._frozen = self._run = 0
        self._first: dict[str, int] = {}  # stamp of the first case of each kind
        self._geometry = GeometryCheck(topic)
        self._last = b""
        self._last_stamp_ns = 0
        self._standing = 0  # scans that repeat while the robot stands, or while nobody knows
        self._moved: float | None = None  # m or rad since the run of equal scans began
        self._periods, self._sweeps = Sampled(_SAMPLES), Sampled(_SAMPLES)

    def feed_motion(self, amount: float) -> None:
        """Take in how far the odometry moved since it was last asked (m, or rad if more)."""
        self._moved = (self._moved or 0.0) + amount

    def feed(self, scan: LaserScan) -> None:
        """Take in one scan."""
        self._scans += 1
        if self._last_stamp_ns:
            self._periods.add((scan.stamp_ns - self._last_stamp_ns) * 1e-9)
        if scan.beam_period_s > 0:
            self._sweeps.add(scan.beam_period_s * len(scan.ranges))
        self._last_stamp_ns = scan.stamp_ns
        self._judge_geometry(scan)
        self._judge_ranges(scan)

    def _judge_geometry(self, scan: LaserScan) -> None:
        n = len(scan.ranges)
        angles = scan.angle_min, scan.angle_step
        sound = all(map(math.isfinite, angles)) and 0 < abs(scan.angle_step) * (n - 1) < 6.4
        if not sound or abs(scan.angle_min) > 100.0:
            self._impossible += 1
            self._first.setdefault("impossible", scan.stamp_ns)
            return
        self._geometry.feed(scan)
        ranges = scan.ranges.tobytes()
        if ranges == self._last and _sees(scan):
            self._run += 1
        else:
            self._run = 0
            self._moved = self._moved and 0.0
        if self._run >= FROZEN_SCANS:
            if (self._moved or 0.0) > STANDS:
                self._frozen += 1
                self._first.setdefault("frozen", scan.stamp_ns)
            else:
                self._standing += 1
                self._first.setdefault("standing", scan.stamp_ns)
        self._last = ranges

    def _judge_ranges(self, scan: LaserScan) -> None:
        ranges = scan.ranges
        finite = np.isfinite(ranges)
        self._beams += ranges.size
        self._nan += int(np.count_nonzero(np.isnan(ranges)))
        with np.errstate(invalid="ignore", over="ignore"):  # limits beyond what ranges can hold
            self._far += int(np.count_nonzero(finite & (ranges > scan.range_max)))
            self._near += int(np.count_nonzero((ranges < scan.range_min) | (ranges <= 0)))
        if not _sees(scan):
            self._blind += 1
            self._first.setdefault("blind", scan.stamp_ns)

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        if not self._scans:
            yield Finding("error", "no-scans", self.topic, "there is no scan: no map can be made")
            return
        yield from self._geometry_findings()
        yield from self._range_findings()

    def _geometry_findings(self) -> Iterator[Finding]:
        if self._impossible:
            yield self._finding(
                "error", "scan-geometry", "impossible", self._impossible,
                "scans have impossible angles or span more than a turn",
            )  # fmt: skip
        yield from self._geometry.findings()
        sweep_s, period_s = self._sweeps.median, self._periods.median
        if sweep_s < SWEEP_SHARE * period_s:
            yield Finding(
                "warning", "scan-time", self.topic,
                f"by its time from beam to beam a scan takes {seconds(sweep_s)}, but they come "
                f"every {seconds(period_s)}: its beam times are not used",
            )  # fmt: skip

    def _range_findings(self) -> Iterator[Finding]:
        if self._blind:
            severity: Severity = "warning" if self._blind > 0.01 * self._scans else "note"
            yield self._finding(
                severity, "blind-scans", "blind", self._blind,
                f"of {self._scans} scans bring back next to nothing",
            )  # fmt: skip
        if self._frozen:
            yield self._finding(
                "error", "frozen-scans", "frozen", self._frozen,
                f"scans repeat the {FROZEN_SCANS} before them exactly: the laser is stuck",
            )  # fmt: skip
        if self._standing:
            known = self._moved is not None
            yield self._finding(
                "note" if known else "warning", "still-scans", "standing", self._standing,
                f"scans repeat the {FROZEN_SCANS} before them exactly"
                + (
                    " while the robot stands: a simulator without noise" if known
                    else ": the laser is stuck, or a simulated robot stands"
                ),
            )  # fmt: skip
        for count, code, what in (
            (self._nan, "ranges-nan", "are unusable (nan)"),
            (self._far, "ranges-far", "lie beyond the laser's declared reach"),
            (self._near, "ranges-near", "are zero, negative or nearer than the laser can see"),
        ):
            share = count / max(self._beams, 1)
            if share > (NAN_SHARE if code == "ranges-nan" else 0.01):
                text = f"{100 * share:.1f} % of all ranges {what}"
                yield Finding("warning", code, self.topic, text, count)

    def _finding(self, severity: Severity, code: str, kind: str, count: int, text: str) -> Finding:
        return Finding(
            severity, code, self.topic, f"{count} {text}", count, self._first.get(kind, 0)
        )


def _sees(scan: LaserScan) -> bool:
    return int(np.count_nonzero(np.isfinite(scan.ranges))) > BLIND_SHARE * scan.ranges.size
