"""Transforms of a ROS bag: where the laser sits on the base, tilt and mirror included."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

BASE_FRAMES = ("base_link", "base_footprint", "base")
"""Names of the robot's own frame, the first one that is found counts (REP-105)."""

TILT_RAD = math.radians(10.0)
"""A laser tilted by more than this does not scan a plane along the floor."""

_FRAMES_LIMIT = 1000  # a bag is somebody else's


class Mount(NamedTuple):
    """`base_T_laser` in the plane; a laser that hangs upside down turns the other way."""

    x: float  # m
    y: float  # m
    theta: float  # rad
    upside_down: bool
    tilt: float  # rad, of the laser's axis against the base's


class FrameTree:
    """The transforms of `/tf_static` and `/tf`; of one that changes the first counts."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], NDArray[np.float64]] = {}

    def add(self, transform: Any) -> None:
        """Take in a geometry_msgs/TransformStamped."""
        parent, child = plain(transform.header.frame_id), plain(transform.child_frame_id)
        matrix = matrix_of(transform.transform.translation, transform.transform.rotation)
        if matrix is not None and len(self._edges) < _FRAMES_LIMIT:
            self._edges.setdefault((parent, child), matrix)

    def extrinsics(self, laser: str, base: str = "") -> Mount | None:
        """Return where the laser's frame sits, None if no path leads to it."""
        laser = plain(laser)
        for name in (base,) if base else BASE_FRAMES:
            if name == laser:
                return Mount(0.0, 0.0, 0.0, False, 0.0)
            matrix = self._between(name, laser)
            if matrix is not None:
                return _planar(matrix)
        return None

    def _between(self, start: str, goal: str) -> NDArray[np.float64] | None:
        """Return start_T_goal over any chain of transforms, either way round."""
        found = {start: np.eye(4)}
        queue = deque([start])
        while queue:
            frame = queue.popleft()
            if frame == goal:
                return found[frame]
            for (parent, child), matrix in self._edges.items():
                if parent == frame and child not in found:
                    found[child] = found[frame] @ matrix
                    queue.append(child)
                elif child == frame and parent not in found:
                    found[parent] = found[frame] @ np.linalg.inv(matrix)
                    queue.append(parent)
        return None


def plain(frame: str) -> str:
    """Return a frame's name without the leading slash that ROS 1 programs wrote."""
    return frame.lstrip("/")


def yaw_of(rotation: Any) -> float:
    """Return the heading of a geometry_msgs/Quaternion (rad)."""
    x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def matrix_of(translation: Any, rotation: Any) -> NDArray[np.float64] | None:
    """Return a 4x4 transform, None if it is not finite or not a rotation."""
    q = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
    t = np.array([translation.x, translation.y, translation.z])
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


def _planar(matrix: NDArray[np.float64]) -> Mount:
    upside_down = bool(matrix[2, 2] < 0.0)
    theta = math.atan2(matrix[1, 0], matrix[0, 0])  # where the laser's x axis points
    tilt = math.acos(min(1.0, abs(float(matrix[2, 2]))))
    return Mount(float(matrix[0, 3]), float(matrix[1, 3]), theta, upside_down, tilt)
