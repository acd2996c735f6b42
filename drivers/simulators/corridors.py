"""Corridor worlds: plain, with doors, and a ladder of corridors that all look alike."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from slam.drivers.simulators.outlines import Array, Point, Recess, recessed_wall
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

Plan = tuple[World, tuple[Leg, ...]]


def plain_corridor(rng: np.random.Generator) -> Plan:
    """Two metres wide and nearly featureless, its ends out of a 30 m laser's reach.

    Only door frames, 4 cm deep and 6 to 14 m apart, tell how far the robot has come.
    """
    walls = [
        recessed_wall((-32.0, 1.0), (80.0, 1.0), _recesses(rng, 112.0, (6.0, 14.0), (0.04, 0.04))),
        recessed_wall(
            (80.0, -1.0), (-32.0, -1.0), _recesses(rng, 112.0, (6.0, 14.0), (0.04, 0.04))
        ),
    ]
    return World(np.vstack(walls)), (Leg(((0.0, 0.0), (46.0, 0.0))),)


def door_corridor(rng: np.random.Generator) -> Plan:
    """Forty metres with doors in niches, driven there and back, with a reversing piece."""
    length = 40.0
    walls = [
        recessed_wall((0.0, 1.0), (length, 1.0), _recesses(rng, length, (2.5, 5.0), (0.1, 0.3))),
        recessed_wall((length, 1.0), (length, -1.0), ()),
        recessed_wall((length, -1.0), (0.0, -1.0), _recesses(rng, length, (2.5, 5.0), (0.1, 0.3))),
        recessed_wall((0.0, -1.0), (0.0, 1.0), ()),
    ]
    path = (
        Leg(((1.5, 0.0), (20.0, 0.0))),
        Leg(((20.0, 0.0), (17.5, 0.0)), reverse=True),
        Leg(((17.5, 0.0), (38.0, 0.0), (38.0, 0.3), (2.0, 0.3))),
    )
    return World(np.vstack(walls)), path


def _recesses(
    rng: np.random.Generator,
    length: float,
    spacing: tuple[float, float],
    depth: tuple[float, float],
) -> list[Recess]:
    """Draw doors 0.9 m wide at random distances along a wall."""
    recesses, at = [], rng.uniform(0.8, spacing[1])
    while at < length - 0.8:
        recesses.append(Recess(at, 0.9, rng.uniform(*depth)))
        at += rng.uniform(*spacing)
    return recesses


BLOCK = (18.0, 12.0)  # m, length and width of a block between corridors
LANE = 2.0  # m, width of every corridor of the ladder
DOOR_SPACING = 3.0  # m


def symmetric_corridors(rng: np.random.Generator) -> Plan:
    """Two long corridors joined by four cross corridors, all with the same doors.

    The building maps onto itself when turned by half a turn, and each third of it looks
    like the next; only the way there tells them apart.  The seed sets the depth of all
    doors, the same for each.
    """
    depth = rng.uniform(0.08, 0.15)
    length, width = 3.0 * BLOCK[0] + 4.0 * LANE, BLOCK[1] + 2.0 * LANE
    walls = [_doors_all_round((0.0, 0.0), (length, width), depth=-depth)]
    for k in range(3):
        x = LANE + k * (BLOCK[0] + LANE)
        walls.append(_doors_all_round((x, LANE), (x + BLOCK[0], LANE + BLOCK[1]), depth=depth))
    return World(np.vstack(walls)), _ladder_path(length, width)


def _ladder_path(length: float, width: float) -> tuple[Leg, ...]:
    """Round the building, then through the inner corridors, and home; once in reverse."""
    south, north, west, east = 1.0, width - 1.0, 1.0, length - 1.0
    second, third = west + BLOCK[0] + LANE, west + 2.0 * (BLOCK[0] + LANE)
    return (
        Leg(((west, south), (east, south), (east, north), (30.0, north))),
        Leg(((30.0, north), (33.0, north)), reverse=True),
        Leg(((33.0, north), (west, north), (west, south), (second, south), (second, north))),
        Leg(((second, north), (third, north), (third, south), (west, south), (west, 8.0))),
    )


def _doors_all_round(low: Point, high: Point, depth: float) -> Array:
    """Draw a rectangle with the same doors on each side; depth over 0 leads inwards."""
    (x1, y1), (x2, y2) = low, high
    corners = [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]
    sides = []
    for start, end in pairwise(corners):
        side = abs(end[0] - start[0]) + abs(end[1] - start[1])
        count = int((side - 1.0) / DOOR_SPACING)
        first = 0.5 * (side - (count - 1) * DOOR_SPACING)
        doors = [Recess(first + i * DOOR_SPACING, 0.9, depth) for i in range(count)]
        sides.append(recessed_wall(start, end, doors))
    return np.vstack(sides)
