"""Building blocks of simulated worlds: outlines of things as (k, 4) wall segments in metres."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

Array = NDArray[np.float64]
Point = tuple[float, float]


class Recess(NamedTuple):
    """A step in a wall; its middle lies `at` metres from the wall's start."""

    at: float  # m
    width: float  # m
    depth: float  # m, positive to the left of the wall's direction


class Door(NamedTuple):
    """An opening in a thick wall; a closed one is filled by a leaf in the wall's middle."""

    at: float  # m from the wall's start to the middle of the door
    width: float = 0.95  # m
    closed: bool = False


def polyline(points: ArrayLike) -> Array:
    """Join (n, 2) points by n - 1 segments."""
    corners = np.asarray(points, dtype=np.float64)
    return np.hstack([corners[:-1], corners[1:]])


def ring(points: ArrayLike) -> Array:
    """Join (n, 2) points by n segments, back to the first."""
    corners = np.asarray(points, dtype=np.float64)
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def box(x: float, y: float, length: float, width: float, theta: float = 0.0) -> Array:
    """Outline a rectangle about its middle (x, y), its length along `theta`."""
    corners = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [length, width]
    cos, sin = math.cos(theta), math.sin(theta)
    return ring(corners @ np.array([[cos, sin], [-sin, cos]]) + [x, y])


def pillar(x: float, y: float, radius: float, sides: int = 8) -> Array:
    """Outline a round pillar as a polygon whose corners lie on the circle."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return ring(np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)]))


def recessed_wall(start: Point, end: Point, recesses: Iterable[Recess]) -> Array:
    """Draw one face of a wall with steps; recesses are in order and do not overlap."""
    profile = [(0.0, 0.0)]
    for at, width, depth in recesses:
        near, far = at - 0.5 * width, at + 0.5 * width
        profile += [(near, 0.0), (near, depth), (far, depth), (far, 0.0)]
    profile.append((math.dist(start, end), 0.0))
    return polyline(_along(start, end, profile))


def thick_wall(
    start: Point, end: Point, doors: Sequence[Door] = (), thickness: float = 0.12
) -> Array:
    """Draw both faces, the jambs and the closed leaves of a wall centred on its line."""
    half, begin, parts = 0.5 * thickness, 0.0, []
    for door in sorted(doors):
        near, far = door.at - 0.5 * door.width, door.at + 0.5 * door.width
        parts.append(ring(_along(start, end, _block(begin, near, half))))
        if door.closed:
            parts.append(polyline(_along(start, end, [(near, 0.0), (far, 0.0)])))
        begin = far
    parts.append(ring(_along(start, end, _block(begin, math.dist(start, end), half))))
    return np.vstack(parts)


def _block(near: float, far: float, half: float) -> list[Point]:
    return [(near, -half), (far, -half), (far, half), (near, half)]


def _along(start: Point, end: Point, profile: Sequence[Point]) -> Array:
    """Turn (distance along, distance to the left) of the line start-end into world points."""
    ahead = (np.asarray(end) - start) / math.dist(start, end)
    left = np.array([-ahead[1], ahead[0]])
    steps = np.asarray(profile)
    points: Array = np.asarray(start) + steps[:, :1] * ahead + steps[:, 1:] * left
    return points


def way_points(path: Sequence[Leg], spacing: float = 0.1) -> Array:
    """Return points on all legs about `spacing` apart, (n, 2), to keep things off the path."""
    pieces = []
    for leg in path:
        for a, b in pairwise(leg.points):
            pieces.append(np.linspace(a, b, max(2, round(math.dist(a, b) / spacing) + 1)))
    return np.vstack(pieces)


def keeps_off(outline: Array, points: Array, distance: float) -> bool:
    """Whether every segment of `outline` stays `distance` metres away from `points`."""
    return bool(World(outline).clearance(points).min() >= distance)
