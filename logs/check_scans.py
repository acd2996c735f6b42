"""Checks of scans: geometry, ranges, and a laser that sees nothing or always the same."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np
from slam.logs.findings import Finding, Severity
from slam.logs.messages import LaserScan

NAN_SHARE = 0.5  # of all beams: more of them unusable is a defect or a wrong import
BLIND_SHARE = 0.05  # of beams that bring something back; below it a scan is blind
FROZEN_SCANS = 5  # so many equal scans in a row: noise alone makes that impossible
TWO_LASERS_SHARE = 0.1  # of the scans have another geometry than the one before
_GEOMETRIES = 16

_Geometry = tuple[int, int, int]  # beams, start in 0.01 rad, step in 1e-5 rad


class ScanCheck:
    """Scans of one channel, in file order."""

    def __init__(self, topic: str = "/scan") -> None:
        self.topic = topic
        self._scans = self._beams = self._nan = self._far = self._near = 0
        self._blind = self._impossible = self._changes = self._beam_changes = 0
        self._frozen = self._run = 0
        self._first: dict[str, int] = {}  # stamp of the first case of each kind
        self._geometries: Counter[_Geometry] = Counter()
        self._last: tuple[_Geometry, bytes] | None = None

    def feed(self, scan: LaserScan) -> None:
        """Take in one scan."""
        self._scans += 1
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
        geometry = n, round(scan.angle_min * 100), round(scan.angle_step * 1e5)
        ranges = scan.ranges.tobytes()
        if self._last is not None:
            last, before = self._last
            self._changes += geometry != last
            self._beam_changes += n != last[0]
            if n != last[0]:
                self._first.setdefault("beams", scan.stamp_ns)
            self._run = self._run + 1 if ranges == before and _sees(scan) else 0
            if self._run >= FROZEN_SCANS:
                self._frozen += 1
                self._first.setdefault("frozen", scan.stamp_ns)
        if geometry in self._geometries or len(self._geometries) < _GEOMETRIES:
            self._geometries[geometry] += 1
        self._last = geometry, ranges

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
        often = self._changes > max(1, TWO_LASERS_SHARE * self._scans)
        if often and len(self._geometries) < _GEOMETRIES:
            yield Finding(
                "error", "two-lasers", self.topic,
                f"the scans change between {len(self._geometries)} geometries {self._changes} "
                "times: two lasers share this channel; record or import one of them",
                self._changes,
            )  # fmt: skip
        elif self._beam_changes:
            yield self._finding(
                "warning", "beam-count", "beams", self._beam_changes,
                "changes of the number of beams",
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
