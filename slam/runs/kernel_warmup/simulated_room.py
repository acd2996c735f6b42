"""A scan of an imaginary room, for kernels to be compiled with."""

from __future__ import annotations

import numpy as np

from slam.logs.messages import LaserScan

_ROOM_M = (4.0, 3.0)  # half length and half width of the room that is measured
_BEAMS = 181


def measure_room(stamp_ns: int, x: float) -> LaserScan:
    """Measure the room from (x, 0)."""
    bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _BEAMS)
    cos, sin = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):
        to_end = (np.where(cos > 0, _ROOM_M[0], -_ROOM_M[0]) - x) / cos
        to_side = _ROOM_M[1] / np.abs(sin)
    ranges = np.minimum(to_end, to_side).astype(np.float32)
    ranges[60:66] -= np.float32(0.4)  # a post, so that the walls are not all there is
    return LaserScan(stamp_ns, -0.5 * np.pi, np.pi / (_BEAMS - 1), ranges, 0.02, 30.0)
