"""Planar poses as rows [x, y, theta] (m, m, rad): their algebra on whole arrays.

`gtsam.Pose2` is the type of a single pose; this is for thousands at once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Poses = NDArray[np.float64]  # (n, 3), or (3,) where a single pose is allowed


def wrap(theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles in [-pi, pi]; those already there come back unchanged."""
    turns = np.round(theta / (2.0 * math.pi))
    return np.where(np.abs(theta) <= math.pi, theta, theta - 2.0 * math.pi * turns)


def compose(a_T_b: Poses, b_T_c: Poses) -> Poses:
    """Return `a_T_c` row by row; either argument may be a single pose of shape (3,)."""
    cosine, sine = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    x = a_T_b[..., 0] + cosine * b_T_c[..., 0] - sine * b_T_c[..., 1]
    y = a_T_b[..., 1] + sine * b_T_c[..., 0] + cosine * b_T_c[..., 1]
    return np.stack([x, y, wrap(a_T_b[..., 2] + b_T_c[..., 2])], axis=-1)


def between(a_T_b: Poses, a_T_c: Poses) -> Poses:
    """Return `b_T_c` = inverse(`a_T_b`) `a_T_c` row by row; either may be a single (3,) pose."""
    b_T_c = unwrapped_between(a_T_b, a_T_c)
    b_T_c[..., 2] = wrap(b_T_c[..., 2])
    return b_T_c


def unwrapped_between(a_T_b: Poses, a_T_c: Poses) -> Poses:
    """Return `between` with the plain difference of headings, which may exceed half a turn."""
    cosine, sine = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    dx, dy = a_T_c[..., 0] - a_T_b[..., 0], a_T_c[..., 1] - a_T_b[..., 1]
    theta = a_T_c[..., 2] - a_T_b[..., 2]
    return np.stack([cosine * dx + sine * dy, cosine * dy - sine * dx, theta], axis=-1)


def logmap(poses: Poses) -> Poses:
    """Return the tangent vectors (n, 3) of poses (n, 3), headings taken within half a turn."""
    turn = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    half = 0.5 * turn
    # x of half / tan(half) towards 1 where there is no turn.
    along = np.where(np.abs(turn) < 1e-6, 1.0, half / np.tan(np.where(turn == 0.0, 1.0, half)))
    x, y = poses[:, 0], poses[:, 1]
    return np.column_stack([along * x + half * y, along * y - half * x, turn])


def placed(points: NDArray[np.float64], map_T_base: Poses) -> NDArray[np.float64]:
    """Return points (n, 2), each given in the frame of its own pose (n, 3), in the map frame."""
    c, s = np.cos(map_T_base[:, 2]), np.sin(map_T_base[:, 2])
    x = map_T_base[:, 0] + c * points[:, 0] - s * points[:, 1]
    y = map_T_base[:, 1] + s * points[:, 0] + c * points[:, 1]
    return np.column_stack([x, y])
