"""Whether the scans of one channel come from one laser: many do not give as many beams each turn.

Small turning lasers send 453 beams in one sweep and 457 in the next, with a constant step or
with one that fits; they begin and end in the same direction.  Two lasers on one channel look
in other directions, or take turns with two quite different numbers of beams.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from slam.logs.findings import Finding
from slam.logs.messages import LaserScan

START_RAD = 0.05  # one laser begins within 3 degrees of the same direction
END_RAD = 0.1  # and ends within 6, or
STEP_SHARE = 0.05  # has the same step within 5 %
BEAMS_RATIO = 1.25  # two numbers of beams farther apart, and few others, are of two lasers
FEW_COUNTS = 3
TWO_LASERS_SHARE = 0.1  # of the scans are unlike the one before
_KEPT = 16  # of views or numbers of beams; a laser that changes more often is one that varies


class GeometryCheck:
    """Takes in the scans of one channel whose angles are sound, in file order."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._scans = self._view_changes = self._beam_changes = 0
        self._first_change_ns = 0
        self._views: list[tuple[float, float, float]] = []  # start, end, step (rad)
        self._counts: Counter[int] = Counter()
        self._last: tuple[int, int] | None = None  # view, beams

    def feed(self, scan: LaserScan) -> None:
        """Take in one scan."""
        self._scans += 1
        n = len(scan.ranges)
        view = self._view(scan)
        if n in self._counts or len(self._counts) < _KEPT:
            self._counts[n] += 1
        if self._last is not None:
            self._view_changes += view != self._last[0]
            if n != self._last[1]:
                self._beam_changes += 1
                self._first_change_ns = self._first_change_ns or scan.stamp_ns
        self._last = view, n

    def _view(self, scan: LaserScan) -> int:
        """Return the number of the view that a scan has, a new one if it is like none."""
        end = scan.angle_min + scan.angle_step * (len(scan.ranges) - 1)
        seen = scan.angle_min, end, scan.angle_step
        for number, known in enumerate(self._views):
            if _alike(seen, known):
                return number
        if len(self._views) < _KEPT:
            self._views.append(seen)
        return len(self._views)

    @property
    def _two_lasers(self) -> bool:
        limit = max(1, TWO_LASERS_SHARE * self._scans)
        if self._view_changes > limit and len(self._views) < _KEPT:
            return True
        apart = max(self._counts, default=1) > BEAMS_RATIO * min(self._counts, default=1)
        return self._beam_changes > limit and len(self._counts) <= FEW_COUNTS and apart

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        if self._two_lasers:
            changes = max(self._view_changes, self._beam_changes)
            views = max(len(self._views), len(self._counts))
            yield Finding(
                "error", "two-lasers", self.topic,
                f"the scans change between {views} geometries {changes} times: two lasers share "
                "this channel; record or import one of them", changes,
            )  # fmt: skip
        elif self._beam_changes:
            least, most = min(self._counts), max(self._counts)
            yield Finding(
                "warning", "beam-count", self.topic,
                f"{self._beam_changes} changes of the number of beams ({least} to {most}): each "
                "scan is used by its own angles", self._beam_changes, self._first_change_ns,
            )  # fmt: skip


def _alike(a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    if abs(a[0] - b[0]) > START_RAD or a[2] * b[2] < 0:
        return False
    return abs(a[1] - b[1]) <= END_RAD or abs(a[2] - b[2]) <= STEP_SHARE * abs(b[2])
