"""Correlative scan matching by branch and bound over likelihood fields.

Olson 2009 scores a pose by how likely the points are in a smoothed map of the target; Hess et
al. 2016 search the window exactly, with bounds from maps in which each cell holds the maximum of
a block.  The bounds here are true: a block's value is never below the score of a pose inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from slam.frontend.correlative_kernels import (
    block_maximum,
    blocks_per_axis,
    bound_blocks,
    branch_and_bound,
    stamp,
)

Matrix = NDArray[np.float64]

# Of the best score: an alternative below cannot make a place ambiguous (`ambiguity_ratio`).
ALTERNATIVE_SHARE = 0.7


class CorrelativeConfig(BaseModel):
    """The search that seeds a loop closure."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    resolution: float = Field(0.10, gt=0, description="m, cell of the likelihood field")
    smoothing: float = Field(0.12, gt=0, description="m, sigma of a point's likelihood")
    levels: int = Field(5, ge=1, le=8, description="block sizes 1, 2, 4, ... cells")
    max_points: int = Field(240, ge=20, description="query points, evenly subsampled")
    max_range: float = Field(20.0, gt=0, description="m, farther points do not count")


@dataclass(frozen=True, eq=False, slots=True)
class LikelihoodField:
    """Likelihood (0 to 1) of a point at each cell, in the target frame, and its block maxima."""

    levels: NDArray[np.float32]  # (levels, rows, columns), row y, column x
    origin: Matrix  # (2,) m, outer corner of cell (0, 0)
    resolution: float  # m


@dataclass(frozen=True, eq=False, slots=True)
class Window:
    """Poses to search: a box about a centre in the target frame."""

    centre: Pose2  # target_T_query
    reach: float  # m, to either side in x and y
    turn: float  # rad, to either side


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """The best pose of a window, and the best one that is a different place."""

    target_T_query: Pose2
    score: float  # mean likelihood of the points, 0 to 1
    second_score: float  # the best score at least `apart` away, 0 if none came near


def build_field(points: Matrix, config: CorrelativeConfig) -> LikelihoodField:
    """Likelihood field of target points (n, 2), m."""
    pad = 3.0 * config.smoothing + config.resolution
    low, high = points.min(axis=0) - pad, points.max(axis=0) + pad
    shape = np.ceil((high - low) / config.resolution).astype(np.int64) + 1
    levels = np.zeros((config.levels, shape[1], shape[0]), dtype=np.float32)
    stamp(points, low, config.resolution, config.smoothing, levels[0])
    for level in range(1, config.levels):
        block_maximum(levels[level - 1], 1 << (level - 1), levels[level])
    return LikelihoodField(levels, low, config.resolution)


def thin(points: Matrix, cell: float, limit: int) -> Matrix:
    """One point a cell (the first), then every k-th so that at most `limit` remain; (m, 2)."""
    cells = np.floor(points / cell).astype(np.int64)
    _, first = np.unique(cells[:, 0] * 1_000_003 + cells[:, 1], return_index=True)
    kept = points[np.sort(first)]
    stride = max(1, -(-len(kept) // limit))
    return np.ascontiguousarray(kept[::stride])


def search(
    field: LikelihoodField, points: Matrix, window: Window, min_score: float, apart: float = 1.0
) -> Found | None:
    """Best pose of query `points` (n, 2) in the window; None if nothing reaches `min_score`.

    Exact on the grid of `resolution` in x and y and of the angle that moves the farthest point
    by one cell.  The second-best pose lies at least `apart` metres from the best.
    """
    if len(points) == 0:
        return None
    res = field.resolution
    far = max(float(np.hypot(points[:, 0], points[:, 1]).max()), 1.0)
    step = res / far
    turns = max(1, int(np.ceil(window.turn / step)))
    angles = window.centre.theta() + np.arange(-turns, turns + 1) * min(step, window.turn / turns)
    cells = max(1, int(np.ceil(window.reach / res)))
    x0 = (window.centre.x() - field.origin[0]) / res
    y0 = (window.centre.y() - field.origin[1]) / res
    best = np.zeros(4)
    nothing = np.array([0.0, 0.0, -1.0])
    shape = len(angles), len(points)
    xs, ys = np.empty(shape, dtype=np.int64), np.empty(shape, dtype=np.int64)
    bounds = np.empty(len(angles) * blocks_per_axis(len(field.levels), cells) ** 2)
    bound_blocks(field.levels, points / res, angles, x0, y0, cells, xs, ys, bounds)
    nodes = bounds, np.argsort(-bounds, kind="stable")
    stack = np.empty((4 * len(field.levels) + 4, 4))
    found = branch_and_bound(
        field.levels, (xs, ys), nodes, angles, cells, min_score, nothing, stack, best
    )
    if not found:
        return None
    second = np.zeros(4)
    excluded = np.array([best[1], best[2], apart / res])
    # Only an alternative that comes near the best is of interest.
    threshold = ALTERNATIVE_SHARE * best[0]
    other = branch_and_bound(
        field.levels, (xs, ys), nodes, angles, cells, threshold, excluded, stack, second
    )
    pose = Pose2(
        window.centre.x() + best[1] * res, window.centre.y() + best[2] * res, float(best[3])
    )
    return Found(pose, float(best[0]), float(second[0]) if other else 0.0)
