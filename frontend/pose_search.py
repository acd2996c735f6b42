"""Where in a whole map a scan may have been taken, at any heading: the best of all poses.

Every position of a grid and every heading is scored by the mean likelihood of the points (Olson
2009), in a field so smooth that no pose between two of them is missed.  Unlike `correlative.search`
this gives many places that differ, not the best one: which of them is right, a match must say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.correlative import thin
from slam.frontend.correlative_kernels import stamp
from slam.frontend.pose_search_kernels import score_poses

Matrix = NDArray[np.float64]

CELL_M = 0.2  # m between two positions; a match begins at half of that
SMOOTHING_M = 0.25  # m: a point half a cell and half a heading off still scores 0.6
HEADINGS = 120  # of the full turn: 0.26 m apart at half the range
MAX_RANGE_M = 10.0  # m, farther points do not count: between two headings they would be lost
MAX_POINTS = 80
APART_M, APART_RAD = 0.6, 0.3  # two results nearer than both are the same one
NEAR_BEST = 0.6  # share of the best score; what scores less is not looked at
MOST_LOOKED_AT = 10_000  # poses, the best ones, from which places that differ are chosen


class Candidate(NamedTuple):
    """A pose that may be the right one."""

    map_T_base: Pose2
    score: float  # mean likelihood of the points, 0 to 1


@dataclass(frozen=True, eq=False, slots=True)
class PoseField:
    """Likelihood of a point at each cell of a map, and the cells where a robot may stand."""

    field: NDArray[np.float32]
    origin: Matrix  # (2,) m, outer corner of cell (0, 0)
    rows: NDArray[np.int64]  # (m,) of the positions
    columns: NDArray[np.int64]

    @property
    def area(self) -> float:
        """Where a robot may stand, m^2."""
        return len(self.rows) * CELL_M**2

    def about(self, x: float, y: float, reach: float) -> PoseField:
        """The same, with the positions within `reach` m of a point alone."""
        px = self.origin[0] + (self.columns + 0.5) * CELL_M - x
        py = self.origin[1] + (self.rows + 0.5) * CELL_M - y
        near = np.hypot(px, py) <= reach
        return PoseField(self.field, self.origin, self.rows[near], self.columns[near])


def pose_field(points: Matrix, ways: Matrix, reach: float) -> PoseField:
    """Field of map points (n, 2) for robots within `reach` m of where one has been, (m, 2)."""
    pad = MAX_RANGE_M + reach + 2 * CELL_M
    low = np.minimum(points.min(axis=0), ways.min(axis=0)) - pad
    high = np.maximum(points.max(axis=0), ways.max(axis=0)) + pad
    columns, rows = np.ceil((high - low) / CELL_M).astype(np.int64) + 1
    field = np.zeros((rows, columns), dtype=np.float32)
    stamp(np.ascontiguousarray(points), low, CELL_M, SMOOTHING_M, field)
    stands = np.zeros((rows, columns), dtype=bool)
    half = int(reach / CELL_M)
    steps = np.arange(-half, half + 1)
    disc = np.hypot(steps[:, None], steps[None, :]) <= half
    for column, row in np.unique(np.floor((ways - low) / CELL_M).astype(np.int64), axis=0):
        window = stands[row - half : row + half + 1, column - half : column + half + 1]
        window |= disc
    at = np.nonzero(stands)
    return PoseField(field, low, at[0].astype(np.int64), at[1].astype(np.int64))


def likely_poses(
    field: PoseField, points: Matrix, count: int, heading: float = 0.0, turn: float = math.pi
) -> list[Candidate]:
    """The best poses that differ, at most `count`, the best one first.

    Args:
        field: of the map.
        points: (n, 2) m, of the scan in the base frame.
        count: how many are wanted.
        heading: rad, about which to search.
        turn: rad to either side of it.
    """
    near = points[np.hypot(points[:, 0], points[:, 1]) < MAX_RANGE_M]
    if len(near) == 0 or len(field.rows) == 0:
        return []
    cloud = thin(near, CELL_M / 2, MAX_POINTS)
    step = 2 * math.pi / HEADINGS
    each_way = math.ceil(turn / step)
    ways = np.arange(-each_way, each_way + 1)[:HEADINGS]
    angles = np.asarray(heading + step * ways, dtype=np.float64)
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    # From the middle of a cell.
    dx = np.floor((c * cloud[:, 0] - s * cloud[:, 1]) / CELL_M + 0.5)
    dy = np.floor((s * cloud[:, 0] + c * cloud[:, 1]) / CELL_M + 0.5)
    width = field.field.shape[1]
    positions = (field.rows * width + field.columns).astype(np.int32)
    scores = np.empty((len(positions), len(angles)), dtype=np.float32)
    score_poses(field.field.ravel(), positions, (dy * width + dx).astype(np.int32), scores)
    return _different(field, scores, angles, count)


def _different(
    field: PoseField, scores: NDArray[np.float32], angles: Matrix, count: int
) -> list[Candidate]:
    """The best poses, none within the reach of a better one."""
    flat = scores.ravel()
    kept = np.flatnonzero(flat >= NEAR_BEST * flat.max())
    kept = kept[np.argsort(-flat[kept], kind="stable")][:MOST_LOOKED_AT]
    at, heading = np.divmod(kept, scores.shape[1])
    x = field.origin[0] + (field.columns[at] + 0.5) * CELL_M
    y = field.origin[1] + (field.rows[at] + 0.5) * CELL_M
    theta = angles[heading]
    found: list[Candidate] = []
    left = np.arange(len(kept))
    while len(left) and len(found) < count:
        best = left[0]
        score = float(flat[kept[best]])
        found.append(Candidate(Pose2(float(x[best]), float(y[best]), float(theta[best])), score))
        away = np.hypot(x[left] - x[best], y[left] - y[best])
        turned = np.abs(np.remainder(theta[left] - theta[best] + math.pi, 2 * math.pi) - math.pi)
        left = left[(away > APART_M) | (turned > APART_RAD)]
    return found
