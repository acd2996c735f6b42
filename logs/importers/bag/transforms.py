"""Transforms of ROS as matrices, and matrices as places in the plane."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


class Mount(NamedTuple):
    """`base_T_laser` in the plane; a laser that hangs upside down turns the other way."""

    x: float  # m
    y: float  # m
    theta: float  # rad
    upside_down: bool = False
    tilt: float = 0.0  # rad, of the laser's axis against the base's


def stamp_of(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def yaw_of(rotation: Any) -> float:
    """Return the heading of a geometry_msgs/Quaternion (rad); nan if it is none."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    square = x * x + y * y + z * z + w * w
    if not (math.isfinite(square) and square > 1e-12):
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def matrix_of(translation: Any, rotation: Any) -> Matrix | None:
    """Return a 4x4 transform, None if it is not finite or not a rotation."""
    q = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    t = np.array([translation.x, translation.y, translation.z])
    with np.errstate(over="ignore", invalid="ignore"):
        norm = float(q @ q)
    if not (np.isfinite(t).all() and math.isfinite(norm) and norm > 1e-12):
        return None
    x, y, z, w = q / math.sqrt(norm)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = t
    return matrix


def planar(matrix: Matrix) -> Mount:
    """Return where a frame sits in the plane of another."""
    upside_down = bool(matrix[2, 2] < 0.0)
    theta = math.atan2(matrix[1, 0], matrix[0, 0])  # where the laser's x axis points
    tilt = math.acos(min(1.0, abs(float(matrix[2, 2]))))
    return Mount(float(matrix[0, 3]), float(matrix[1, 3]), theta, upside_down, tilt)
