"""A furnished room and a drive that shows all there is to calibrate, in three minutes."""

from __future__ import annotations

import math

import numpy as np
from slam.drivers.simulators.corridors import Plan
from slam.drivers.simulators.outlines import box, keeps_off, ring, way_points
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

LENGTH_M, WIDTH_M = 10.0, 8.5
RADIUS_M = 2.6  # of the stars
POINTS, JUMP = 7, 3  # of a star: at each it turns by 154 degrees, on the spot
PIECES = 14  # of furniture, as far as there is room
KEEP_OFF = 0.6  # m between furniture and the path


def calibration_room(rng: np.random.Generator) -> Plan:
    """Two stars, one with turns to the left and one to the right."""
    corners = [
        (RADIUS_M * math.cos(turn), RADIUS_M * math.sin(turn))
        for turn in (k * JUMP * math.tau / POINTS for k in range(POINTS + 1))
    ]
    path = (Leg(tuple(corners)), Leg(tuple(reversed(corners))))
    x, y = 0.5 * LENGTH_M, 0.5 * WIDTH_M
    parts = [ring([(-x, -y), (x, -y), (x, y), (-x, y)])]
    way = way_points(path)
    for _ in range(PIECES):
        at = rng.uniform(-1.0, 1.0, 2) * (x - 0.5, y - 0.5)
        size = rng.uniform(0.3, 1.2, 2)
        piece = box(float(at[0]), float(at[1]), float(size[0]), float(size[1]), rng.uniform(0, 3))
        if keeps_off(piece, way, KEEP_OFF):
            parts.append(piece)
    return World(np.vstack(parts)), path
