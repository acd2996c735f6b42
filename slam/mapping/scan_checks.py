"""What a laser's driver says wrongly of its scans, found in the scans themselves.

Two faults are common.  A stated beam period that does not go with the rate of the scans would bend
each of them; and readings that mean "nothing came back", coded as a range that the laser could
have measured, look like a wall that travels along.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from slam.logs.messages import LaserScan

# A laser that turns takes for its field of view that share of a turn.  Stamps that jitter, and
# scans that were left out in recording, make the period seem longer.
LEAST_SHARE, GREATEST_SHARE = 0.2, 1.4
PERIODS = 15  # between scans, whose median tells the period
LEAST_PERIODS = 3

CODE_BEAMS = 3  # beams that read exactly the same largest range
CODE_SCANS = 5  # scans in a row in which they do
# Share of the beams at which one scan is enough.  A flat wall at 3 m, measured in steps of 5 cm,
# gives the same range to 20 degrees of view.
CODE_SHARE = 0.15


class BeamTiming:
    """Says whether the beams of a scan were measured at the times that it states."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._periods: deque[float] = deque(maxlen=PERIODS)
        self.contradicted = 0  # scans

    def checked(self, scan: LaserScan) -> LaserScan:
        """The scan, without its beam period if that cannot be."""
        if self._last_ns is not None and scan.stamp_ns > self._last_ns:
            self._periods.append((scan.stamp_ns - self._last_ns) * 1e-9)
        self._last_ns = scan.stamp_ns
        if not scan.beam_period_s or len(self._periods) < LEAST_PERIODS:
            return scan
        period = float(np.median(self._periods))
        a_turn = scan.beam_period_s * 2.0 * math.pi / abs(scan.angle_step)
        if LEAST_SHARE <= a_turn / period <= GREATEST_SHARE:
            return scan
        self.contradicted += 1
        return replace(scan, beam_period_s=0.0)


class NothingCode:
    """Finds the range that stands for "nothing came back": the largest, and of many beams.

    No two beams measure the same largest range to the last digit, scan after scan.  A reading
    beyond it shows that it was none.
    """

    def __init__(self) -> None:
        self.code: float | None = None  # m
        self._largest = math.nan  # m, of the last scan
        self._scans = 0  # in a row with that one
        self.beams = 0  # that read the code

    def removed(self, scan: LaserScan) -> LaserScan:
        """The scan, with beams that read the code as beams without a return."""
        self._watch(scan)
        return self.without_code(scan)

    def without_code(self, scan: LaserScan) -> LaserScan:
        """The same by what is known now."""
        if self.code is None:
            return scan
        coded = scan.ranges == np.float32(self.code)
        count = int(np.count_nonzero(coded))
        if not count:
            return scan
        self.beams += count
        return replace(scan, ranges=np.where(coded, np.float32(np.inf), scan.ranges))

    def _watch(self, scan: LaserScan) -> None:
        usable = scan.ranges[np.isfinite(scan.ranges) & (scan.ranges < scan.range_max)]
        if not len(usable):
            return
        largest = float(usable.max())
        if self.code is not None and largest > self.code:
            self.code = None
        equal = int(np.count_nonzero(usable == usable.max()))
        if equal < CODE_BEAMS:
            self._scans = 0
        elif largest == self._largest:
            self._scans += 1
        else:
            self._scans = 1
        self._largest = largest
        if self._scans >= CODE_SCANS or equal > CODE_SHARE * len(scan.ranges):
            self.code = largest
