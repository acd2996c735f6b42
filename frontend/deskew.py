"""Scans taken on the move, as a laser at rest would have taken them.

While a UTM-30LX sweeps its 270 degrees, 19 ms, a robot at 1 rad/s turns by a degree: the last
beam is off by 9 cm at 5 m.  Odometry says how the base moved from the first beam to the last.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from slam.logs.messages import LaserExtrinsics, LaserScan

Vector = NDArray[np.float64]
# When the beams of a scan were measured: from its stamp on, up to its stamp, or from its stamp on
# in reverse, as by a laser that turns clockwise and whose driver sorts its readings.
SweepOrder = Literal["from the stamp", "to the stamp", "in reverse"]
SWEEP_ORDERS: tuple[SweepOrder, ...] = ("from the stamp", "to the stamp", "in reverse")
_GAP = 10.0  # beam spacings between neighbours that lie on one surface


def sweep_ns(scan: LaserScan) -> int:
    """Time from the first beam to the last, ns; 0 if the scan has no timing."""
    return round(scan.beam_period_s * (len(scan.ranges) - 1) * 1e9)


def deskew(
    scan: LaserScan, extrinsics: LaserExtrinsics, moved: tuple[float, float, float],
    order: SweepOrder = "from the stamp",
) -> LaserScan:  # fmt: skip
    """Return the scan that the laser would have made at rest where it was at the scan's stamp.

    Beams keep their bearings.  A bearing that no beam looked along in truth, at one end of a
    scan taken while turning, reads nan.

    Args:
        scan: with `beam_period_s`.
        extrinsics: `base_T_laser`.
        moved: x, y (m) and theta (rad) of the base at the end of a sweep, seen from its begin; in
            between it moves evenly.
        order: when the beams were measured.
    """
    count = len(scan.ranges)
    if count < 2 or not any(moved):
        return scan
    bearings = scan.angle_min + scan.angle_step * np.arange(count, dtype=np.float64)
    ranges = scan.ranges.astype(np.float64)
    turned, distances = _seen_at_the_stamp(
        bearings, ranges, extrinsics, moved, _shares(count, order)
    )
    at = np.arange(count) + turned / scan.angle_step
    found = resampled(at, distances, abs(scan.angle_step)).astype(np.float32)
    return replace(scan, ranges=found, beam_period_s=0.0)


def _shares(count: int, order: SweepOrder) -> Vector:
    """(count,) of the sweep, from the stamp to each beam."""
    share = np.linspace(0.0, 1.0, count)
    if order == "to the stamp":
        return share - 1.0
    return share[::-1] if order == "in reverse" else share


def _seen_at_the_stamp(
    bearings: Vector, ranges: Vector, extrinsics: LaserExtrinsics,
    moved: tuple[float, float, float], share: Vector,
) -> tuple[Vector, Vector]:  # fmt: skip
    """By how much each beam's bearing changes, (n,) rad, and its range, (n,) m."""
    heading = share * moved[2]
    cos, sin = np.cos(heading), np.sin(heading)
    # From the laser at the stamp to the laser at each beam, in the base's axes then.
    ahead = share * moved[0] + (cos - 1.0) * extrinsics.x - sin * extrinsics.y
    left = share * moved[1] + sin * extrinsics.x + (cos - 1.0) * extrinsics.y
    direction = bearings + extrinsics.theta + heading
    hit = np.isfinite(ranges)
    length = np.where(hit, ranges, 1.0)
    x, y = ahead + length * np.cos(direction), left + length * np.sin(direction)
    seen = np.arctan2(y, x) - extrinsics.theta - bearings
    turned = np.where(hit, np.remainder(seen + np.pi, 2.0 * np.pi) - np.pi, heading)
    return turned, np.where(hit, np.hypot(x, y), ranges)


def resampled(at: Vector, ranges: Vector, step: float, count: int | None = None) -> Vector:
    """Ranges at whole beam numbers, from those at `at`: between two on one surface, else nearest.

    Codes (inf, nan) are handed on; they and edges are never interpolated.  A beam with no reading
    within one of it is nan.

    Args:
        at: (n,) beam numbers, in any order.
        ranges: (n,) m, there.
        step: rad between two whole numbers.
        count: how many beams there are; as many as readings if not given.
    """
    order = np.argsort(at, kind="stable")
    at, ranges = at[order], ranges[order]
    beams = np.arange(len(at) if count is None else count, dtype=np.float64)
    right = np.clip(np.searchsorted(at, beams), 1, len(at) - 1)
    left = right - 1
    span = np.maximum(at[right] - at[left], 1e-9)
    share = np.clip((beams - at[left]) / span, 0.0, 1.0)
    near = np.where(share < 0.5, left, right)
    with np.errstate(invalid="ignore"):
        gap = np.abs(ranges[right] - ranges[left])
        one_surface = gap <= _GAP * step * np.minimum(ranges[left], ranges[right])
        between = ranges[left] + share * (ranges[right] - ranges[left])
    found = np.where(one_surface & np.isfinite(gap), between, ranges[near])
    found[np.abs(at[near] - beams) > 1.0] = np.nan
    return found
