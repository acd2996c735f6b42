"""A town of equal blocks without end: as much new terrain, with loops, as a long drive needs."""

from __future__ import annotations

import numpy as np
from slam.drivers.simulators.outlines import Array, Point, Recess, recessed_wall
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

LENGTH, WIDTH, LANE = 12.0, 8.0, 2.2  # m, of a block and of the lanes between
PITCH_X, PITCH_Y = LENGTH + LANE, WIDTH + LANE


def blocks(columns: int, rows: int, rng: np.random.Generator) -> tuple[World, tuple[Leg, ...]]:
    """Doors in niches, differently on every face; the way goes round each block, row by row.

    Every block closes a loop of 49 m, is left along a lane that was driven before, and shares
    lanes with its neighbours.
    """
    walls = [
        _face(a, b, rng)
        for row in range(rows) for column in range(columns)
        for a, b in _sides(column * PITCH_X, row * PITCH_Y, LENGTH, WIDTH, inwards=True)
    ]  # fmt: skip
    town = (-LANE, -LANE, columns * PITCH_X + LANE, rows * PITCH_Y + LANE)
    walls += [_face(a, b, rng) for a, b in _sides(*town, inwards=False)]
    return World(np.vstack(walls)), (Leg(tuple(_way(columns, rows))),)


def _sides(
    x: float, y: float, length: float, width: float, inwards: bool
) -> list[tuple[Point, Point]]:
    """Sides of a rectangle from its lower corner, its niches to the left: within or without."""
    corners = [(x, y), (x + length, y), (x + length, y + width), (x, y + width)]
    if not inwards:
        corners.reverse()
    return [(corners[k], corners[(k + 1) % 4]) for k in range(4)]


def _face(start: Point, end: Point, rng: np.random.Generator) -> Array:
    """A wall with a door every two to four metres, 0.1 to 0.3 m deep."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    recesses, at = [], rng.uniform(0.8, 2.5)
    while at < length - 0.8:
        recesses.append(Recess(at, 0.9, rng.uniform(0.1, 0.3)))
        at += rng.uniform(2.0, 4.0)
    return recessed_wall(start, end, recesses)


def _way(columns: int, rows: int) -> list[Point]:
    """Round every block anticlockwise, the rows from the first to the last and to and fro."""
    points: list[Point] = [(-0.5 * LANE, -0.5 * LANE)]
    for row in range(rows):
        low, high = row * PITCH_Y - 0.5 * LANE, (row + 1) * PITCH_Y - 0.5 * LANE
        forward = row % 2 == 0
        for k in range(columns):
            column = k if forward else columns - 1 - k
            west, east = column * PITCH_X - 0.5 * LANE, (column + 1) * PITCH_X - 0.5 * LANE
            near, far = (west, east) if forward else (east, west)
            points += [(far, low), (far, high), (near, high), (near, low), (far, low)]
        points.append((points[-1][0], high))
    return points
