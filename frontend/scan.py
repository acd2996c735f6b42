"""Scan preparation: points, and the straight piece of wall around each of them.

A point-to-line match is as good as its lines.  Each beam gets the *longest* window of
neighbours that a straight line explains to within the range noise, so that plain walls
yield normals good to a fraction of a degree (noisy normals would look like information
along the wall) while corners and clutter keep short, one-sided windows.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from slam.frontend.scan_kernels import LINE, VALID, read_scan
from slam.frontend.sparse_scan import without_empty_bins
from slam.logs.messages import LaserExtrinsics, LaserScan

__all__ = ["LINE", "VALID", "PreparedScan", "ScanConfig", "prepare"]


class ScanConfig(BaseModel):
    """How a scan is turned into points and lines."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # Settings of the laser, handed on by the configuration of the run.
    range_noise: float = Field(0.010, gt=0, exclude=True, description="m, one sigma")
    max_range: float = Field(60.0, gt=0, exclude=True, description="m, beyond it nothing is used")
    line_tolerance: float = Field(
        1.0, gt=0, description="sigmas of range_noise that count as noise when fitting a line"
    )
    gap_ratio: float = Field(
        10.0, gt=1, description="a gap wider than this times the beam spacing parts two surfaces"
    )
    normal_sigma_max: float = Field(
        0.20, gt=0, description="rad, less certain normals are not used as lines"
    )
    deskew: bool = Field(
        True, description="take the motion during a sweep out of scans that carry their timing"
    )


class PreparedScan(NamedTuple):
    """A scan ready for matching, in the base frame, ordered by bearing from the laser.

    `lines` holds (nx, ny, d, s2, m) a beam: the unit normal that points to the laser, the offset
    with n . p = d for points p of the line, the variance of the normal's angle (rad^2), and the
    position (-ny, nx) . p of the middle of the points it was fitted to.  `geometry` gives the
    first bearing within half a turn of the base's x axis.
    """

    stamp_ns: int
    points: NDArray[np.float64]  # (n, 2) m; nan where the beam brought nothing back
    lines: NDArray[np.float64]  # (n, 5)
    windows: NDArray[np.int32]  # (n, 2) first and last beam that the line was fitted to
    flags: NDArray[np.uint8]  # (n,) VALID | LINE
    geometry: NDArray[np.float64]  # (5,) angle_min, angle_step (> 0), origin x, y, beams in a turn
    valid: int  # beams with a point
    centre: NDArray[np.float64]  # (2,) m, mean of the nearer points: what the scan looks at
    reach2: NDArray[np.float64]  # (REACH,) sin^2 of the least angle to beam k, to 90 deg
    # The same as a stack of one scan: starts (2,), geometry (1, 5), reach2 (1, REACH).
    alone: tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]

    @property
    def ranges(self) -> NDArray[np.float64]:
        """Distance of each point from the laser, (n,) m; nan where there is none."""
        offsets = self.points - self.geometry[2:4]
        return np.hypot(offsets[:, 0], offsets[:, 1])


BEARING_ERROR = 3e-4  # rad, more than the error of `bearing_of`
REACH = 384  # beams: 90 degrees and more at 0.25 degrees


@lru_cache(maxsize=64)
def reach_table(step: float) -> NDArray[np.float64]:
    """(1, REACH) sin^2 of the least angle to the k-th beam from the nearest, at most 1.

    The nearest beam of `step` (rad) is up to half a step off, its bearing up to BEARING_ERROR.
    """
    angles = np.maximum((np.arange(REACH) - 0.5) * step - BEARING_ERROR, 0.0)
    table: NDArray[np.float64] = np.sin(np.minimum(angles, 0.5 * np.pi))[None] ** 2
    table.setflags(write=False)
    return table


def prepare(scan: LaserScan, extrinsics: LaserExtrinsics, config: ScanConfig) -> PreparedScan:
    """Turn a scan into points with lines in the base frame; any beam count, any field of view."""
    scan = without_empty_bins(scan)
    ranges, angle_min, step = scan.ranges, scan.angle_min, scan.angle_step
    if step < 0:  # a laser that turns clockwise: the same scan, read from its end
        angle_min, step = angle_min + step * (len(ranges) - 1), -step
        ranges = np.ascontiguousarray(ranges[::-1])
        ranges.setflags(write=False)  # as all others are: one compiled kernel serves both
    in_a_turn = 2 * math.pi / step - 1e-6
    whole = len(ranges) if len(ranges) > in_a_turn - 1.5 else math.floor(in_a_turn)
    first = math.remainder(angle_min + extrinsics.theta, 2 * math.pi)  # the search wraps but once
    nearest, farthest = max(scan.range_min, 1e-3), min(scan.range_max, config.max_range)
    points, lines, windows, flags, geometries, centre, starts, valid = read_scan(
        ranges, (first, float(step), float(extrinsics.x), float(extrinsics.y), whole),
        (float(nearest), float(farthest)),
        (config.range_noise, config.line_tolerance, config.gap_ratio, config.normal_sigma_max),
    )  # fmt: skip
    for array in (points, lines, windows, flags, geometries, centre):
        array.setflags(write=False)
    reach2 = reach_table(step)
    alone = starts, geometries, reach2
    return PreparedScan(
        scan.stamp_ns, points, lines, windows, flags, geometries[0], valid, centre, reach2[0], alone
    )  # fmt: skip
