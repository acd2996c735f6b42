"""Ray casting against wall segments: the kernels behind `World`.

A sweep from one point treats the bearings like a one-dimensional depth buffer: each wall
is drawn only into the beams between the bearings of its two ends.  The work therefore
grows with the beams that walls cover, not with beams times walls.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOUCH = 1e-9  # m, and share of a wall's length: closes the seams where walls meet
SLACK = 1e-7  # rad: rounding of atan2 must not cost a wall its outermost beam
TURN = 2.0 * math.pi


@njit(cache=True, nogil=True)
def _hit(x: float, y: float, dx: float, dy: float, wall: Array) -> float:
    """Return the distance from (x, y) along the unit vector (dx, dy) to `wall`, or inf."""
    along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
    to_x, to_y = wall[0] - x, wall[1] - y
    slope = dx * along_y - dy * along_x
    if slope == 0.0:  # parallel, or a wall of no length: edge-on it cannot be seen
        return math.inf
    share = (to_x * dy - to_y * dx) / slope
    distance = (to_x * along_y - to_y * along_x) / slope
    if share < -TOUCH or share > 1.0 + TOUCH or distance < -TOUCH:
        return math.inf
    return float(max(distance, 0.0))


@njit(cache=True, nogil=True)
def _subtended(x: float, y: float, wall: Array) -> tuple[float, float]:
    """Return the bearing of the wall's clockwise end and its width in rad, seen from (x, y)."""
    first_x, first_y, last_x, last_y = wall[0] - x, wall[1] - y, wall[2] - x, wall[3] - y
    turn = math.atan2(
        first_x * last_y - first_y * last_x, first_x * last_x + first_y * last_y
    )  # from the first end to the last, shorter way round
    near = min(math.hypot(first_x, first_y), math.hypot(last_x, last_y))
    if abs(turn) > math.pi - SLACK or near < SLACK:
        return -math.pi, TURN  # the viewer stands on the wall or at its end
    if turn >= 0.0:
        return math.atan2(first_y, first_x), turn
    return math.atan2(last_y, last_x), -turn


@njit(cache=True, nogil=True)
def cast_from_point(
    walls: Array, solid: int, x: float, y: float, theta: float, bearings: Array, range_max: float
) -> Array:
    """Return (n,) ranges in m along `bearings`, (n,) rad, ascending, at most one turn.

    `walls` is (m, 4), of which those after the first `solid` are glass; x, y, theta is
    the laser's pose in their frame.
    """
    nearest = np.full(bearings.size, math.inf)
    answers = np.ones(bearings.size, np.bool_)
    dx, dy = np.cos(bearings + theta), np.sin(bearings + theta)
    for k in range(walls.shape[0]):
        wall = walls[k]
        low, width = _subtended(x, y, wall)
        for lap in range(2):  # a wall may straddle the first bearing: part now, part a turn on
            start = bearings[0] + (low - theta - SLACK - bearings[0]) % TURN - lap * TURN
            end = start + width + 2.0 * SLACK
            i = np.searchsorted(bearings, start)
            while i < bearings.size and bearings[i] <= end:
                distance = _hit(x, y, dx[i], dy[i], wall)
                if distance < nearest[i]:
                    nearest[i], answers[i] = distance, k < solid
                i += 1
    return _within(nearest, answers, range_max)


@njit(cache=True, nogil=True)
def cast_from_each_beam(
    walls: Array, solid: int, origins: Array, angles: Array, range_max: float
) -> Array:
    """Return (n,) ranges in m of beams that start at `origins`, (n, 2), towards `angles`, (n,)."""
    nearest = np.full(angles.size, math.inf)
    answers = np.ones(angles.size, np.bool_)
    for i in range(angles.size):
        dx, dy = math.cos(angles[i]), math.sin(angles[i])
        for k in range(walls.shape[0]):
            distance = _hit(origins[i, 0], origins[i, 1], dx, dy, walls[k])
            if distance < nearest[i]:
                nearest[i], answers[i] = distance, k < solid
    return _within(nearest, answers, range_max)


@njit(cache=True, nogil=True)
def _within(nearest: Array, answers: NDArray[np.bool_], range_max: float) -> Array:
    for i in range(nearest.size):
        if nearest[i] > range_max or not answers[i]:
            nearest[i] = math.inf
    return nearest
