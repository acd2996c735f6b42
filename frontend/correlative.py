"""Correlative scan matching by branch and bound over likelihood fields.

Olson 2009 scores a pose by how likely the points are in a smoothed map of the target; Hess et
al. 2016 search the window exactly, with bounds from maps in which each cell holds the maximum of
a block.  The bounds here are true: a block's value is never below the score of a pose inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Matrix = NDArray[np.float64]


class CorrelativeConfig(BaseModel):
    """The search that seeds a loop closure."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    resolution: float = Field(0.10, gt=0, description="m, cell of the likelihood field")
    smoothing: float = Field(0.12, gt=0, description="m, sigma of a point's likelihood")
    levels: int = Field(5, ge=1, le=8, description="block sizes 1, 2, 4, ... cells")
    max_points: int = Field(240, ge=20, description="query points, thinned evenly")
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
    _stamp(points, low, config.resolution, config.smoothing, levels[0])
    for level in range(1, config.levels):
        _block_maximum(levels[level - 1], 1 << (level - 1), levels[level])
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
    found = _branch_and_bound(
        field.levels, points / res, angles, x0, y0, cells, min_score, nothing, best
    )
    if not found:
        return None
    second = np.zeros(4)
    excluded = np.array([best[1], best[2], apart / res])
    # Only a rival that comes near the best is of interest.
    threshold = 0.7 * best[0]
    rival = _branch_and_bound(
        field.levels, points / res, angles, x0, y0, cells, threshold, excluded, second
    )
    pose = Pose2(
        window.centre.x() + best[1] * res, window.centre.y() + best[2] * res, float(best[3])
    )
    return Found(pose, float(best[0]), float(second[0]) if rival else 0.0)


@njit(cache=True, nogil=True)
def _stamp(points, low, resolution, smoothing, grid):
    """Write each point's likelihood into the cells around it, keeping the maximum."""
    reach = int(np.ceil(3.0 * smoothing / resolution))
    rows, columns = grid.shape
    for k in range(len(points)):
        px = (points[k, 0] - low[0]) / resolution
        py = (points[k, 1] - low[1]) / resolution
        cx, cy = int(px), int(py)
        for y in range(max(0, cy - reach), min(rows, cy + reach + 1)):
            for x in range(max(0, cx - reach), min(columns, cx + reach + 1)):
                dx, dy = (x + 0.5 - px) * resolution, (y + 0.5 - py) * resolution
                value = np.exp(-0.5 * (dx * dx + dy * dy) / (smoothing * smoothing))
                if value > grid[y, x]:
                    grid[y, x] = value


@njit(cache=True, nogil=True)
def _block_maximum(finer, shift, coarser):
    """coarser[y, x] = maximum of finer over the block that begins at (y, x) and is twice as wide."""
    rows, columns = finer.shape
    for y in range(rows):
        for x in range(columns):
            value = finer[y, x]
            if x + shift < columns:
                value = max(value, finer[y, x + shift])
            if y + shift < rows:
                value = max(value, finer[y + shift, x])
                if x + shift < columns:
                    value = max(value, finer[y + shift, x + shift])
            coarser[y, x] = value


@njit(cache=True, nogil=True)
def _score(grid, block, xs, ys, dx, dy):
    """Mean of the grid at the points shifted by (dx, dy) cells; blocks reach beyond the edge."""
    rows, columns = grid.shape
    total = 0.0
    for k in range(len(xs)):
        x, y = xs[k] + dx, ys[k] + dy
        if x >= columns or y >= rows or x <= -block or y <= -block:
            continue
        # A block that begins before the first cell still covers it: its maximum is not larger
        # than that of the block of the same size at the edge.
        total += grid[max(y, 0), max(x, 0)]
    return total / len(xs)


@njit(cache=True, nogil=True)
def _branch_and_bound(levels, points, angles, x0, y0, cells, min_score, excluded, best):
    """Depth-first over blocks, the most promising first; fills best (score, dx, dy, angle).

    `excluded` is (dx, dy, radius) in cells: poses nearer than radius do not count.
    """
    top = len(levels) - 1
    block = 1 << top
    per_axis = (2 * cells) // block + 1
    count = len(angles) * per_axis * per_axis
    n = len(points)
    xs = np.empty((len(angles), n), dtype=np.int64)
    ys = np.empty((len(angles), n), dtype=np.int64)
    bounds = np.empty(count)
    for a in range(len(angles)):
        c, s = np.cos(angles[a]), np.sin(angles[a])
        for k in range(n):
            xs[a, k] = int(np.floor(c * points[k, 0] - s * points[k, 1] + x0))
            ys[a, k] = int(np.floor(s * points[k, 0] + c * points[k, 1] + y0))
        for iy in range(per_axis):
            for ix in range(per_axis):
                node = (a * per_axis + iy) * per_axis + ix
                bounds[node] = _score(
                    levels[top], block, xs[a], ys[a], ix * block - cells, iy * block - cells
                )
    order = np.argsort(-bounds, kind="mergesort")
    best[0] = min_score
    found = False
    stack = np.empty((4 * (top + 1) + 4, 4))  # bound, level, dx, dy
    radius2 = excluded[2] * excluded[2] if excluded[2] > 0.0 else -1.0
    for node in order:
        if bounds[node] <= best[0]:
            break
        a = node // (per_axis * per_axis)
        rest = node % (per_axis * per_axis)
        stack[0, 0], stack[0, 1] = bounds[node], top
        stack[0, 2] = (rest % per_axis) * block - cells
        stack[0, 3] = (rest // per_axis) * block - cells
        size = 1
        while size > 0:
            size -= 1
            bound, level = stack[size, 0], int(stack[size, 1])
            dx, dy = int(stack[size, 2]), int(stack[size, 3])
            if bound <= best[0]:
                continue
            if level == 0:
                ex, ey = dx - excluded[0], dy - excluded[1]
                if abs(dx) <= cells and abs(dy) <= cells and ex * ex + ey * ey > radius2:
                    best[0], best[1], best[2], best[3] = bound, dx, dy, angles[a]
                    found = True
                continue
            half = 1 << (level - 1)
            begin = size
            for child in range(4):
                cx, cy = dx + (child & 1) * half, dy + (child >> 1) * half
                value = _score(levels[level - 1], half, xs[a], ys[a], cx, cy)
                if value <= best[0]:
                    continue
                at = size  # insertion keeps the best child on top of the stack
                while at > begin and stack[at - 1, 0] > value:
                    stack[at] = stack[at - 1]
                    at -= 1
                stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = value, level - 1, cx, cy
                size += 1
    return found
