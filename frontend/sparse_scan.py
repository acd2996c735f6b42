"""Scans whose readings were put into more bins than the laser has beams, at its own spacing.

Drivers of lasers with an irregular number of beams sort them into a fixed number of bearings, and
many bins stay empty (nan).  Neighbours are then never next to each other, and no line can be
fitted to them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from slam.frontend.deskew import resampled
from slam.logs.messages import LaserScan

# Share of the bins that are filled, above which neighbours mostly are next to each other.
DENSE = 0.5


def without_empty_bins(scan: LaserScan) -> LaserScan:
    """The same scan in as many bins as there are readings, about; itself if few bins are empty."""
    bins = len(scan.ranges)
    filled = np.flatnonzero(~np.isnan(scan.ranges))
    if len(filled) > DENSE * bins or len(filled) < 3:
        return scan
    # Most readings have their next neighbour this many bins on; where there is none, the laser saw
    # nothing.
    wide = int(np.median(np.diff(filled)))
    if wide < 2:
        return scan
    count = bins // wide
    middle = 0.5 * (wide - 1)
    ranges = scan.ranges[filled].astype(np.float64)
    found = resampled((filled - middle) / wide, ranges, abs(scan.angle_step) * wide, count)
    return replace(
        scan,
        angle_min=scan.angle_min + middle * scan.angle_step,
        angle_step=scan.angle_step * wide,
        ranges=found.astype(np.float32),
        beam_period_s=scan.beam_period_s * wide,
    )
