"""Places that are hard to map: rows of equal posts, wide halls, trees, and very long loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from slam.drivers.simulators.corridors import Plan
from slam.drivers.simulators.outlines import Array, box, keeps_off, pillar, polyline, way_points
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

Planner = Callable[[np.random.Generator], Plan]

POST_M = 0.04  # half the width of a post: slim, as of a glazed front or a railing
TREE_M = (0.15, 0.35)  # least and largest radius of a trunk
OFF_THE_PATH_M = 0.8  # m between the path and anything put beside it


def posts_corridor(pitch: float, length: float = 30.0, jitter: float = 0.0) -> Planner:
    """A passage 3 m wide between two rows of posts, each `pitch` metres from the next.

    Nothing else tells how far the robot has come, but for the walls at both ends; `jitter` (m,
    one sigma) moves each post.
    """

    def plan(rng: np.random.Generator) -> Plan:
        places = np.arange(0.0, length, pitch)
        parts = [polyline([(-1.0, -1.5), (-1.0, 1.5)]), polyline([(length, -1.5), (length, 1.5)])]
        for y in (-1.4, 1.4):
            for x in places + jitter * rng.standard_normal(len(places)):
                parts.append(box(float(x), y, 2 * POST_M, 2 * POST_M))
        return World.from_parts(parts), (Leg(((0.5, 0.0), (length - 2.0, 0.0))),)

    return plan


def wide_hall(rng: np.random.Generator) -> Plan:
    """Straight across an empty hall: walls ahead and behind, 30 m apart, the others 30 m off.

    A laser that reaches a few metres sees nothing for half of the way.  The seed turns both walls
    a little, as no two halls are alike.
    """
    lean = rng.uniform(-0.05, 0.05, 2)
    corners = [(-2.0, -30.0), (29.0, -30.0 + lean[0]), (29.0 + lean[1], 30.0), (-2.0, 30.0)]
    return World.from_polygon(corners), (Leg(((0.0, 0.0), (27.0, 0.0))),)


def grove(trees: int, size: float = 24.0) -> Planner:
    """A loop among `trees` in a square of `size` metres with one short wall, driven twice."""

    def plan(rng: np.random.Generator) -> Plan:
        low, high = 0.2 * size, 0.8 * size
        loop = ((low, low), (high, low), (high, high), (low, high), (low, low))
        path = (Leg((*loop, *loop[1:])),)
        parts = [polyline([(0.0, 0.4 * size), (0.0, 0.6 * size)])]
        return World.from_parts([*parts, *_trees(rng, trees, size, path)]), path

    return plan


def courtyard(rng: np.random.Generator) -> Plan:
    """A court of 50 by 35 m, open on one side, with six trees; crossed there and back."""
    outline = polyline([(50.0, 0.0), (0.0, 0.0), (0.0, 35.0), (50.0, 35.0)])
    path = (
        Leg(((46.0, 6.0), (8.0, 6.0), (8.0, 29.0), (44.0, 29.0))),
        Leg(((44.0, 29.0), (44.0, 17.0), (8.0, 17.0), (8.0, 6.0), (46.0, 6.0))),
    )
    trees = _trees(rng, 6, 34.0, path)
    return World.from_parts([outline, *trees]), path


def long_loop(side: float, both_ways: bool = True) -> Planner:
    """Round a block of `side` metres through corridors 3 m wide, then round it the other way.

    Doors in niches at random distances, as along a street or a hospital's passages.
    """

    def plan(rng: np.random.Generator) -> Plan:
        middle = 1.5
        corners = [
            (middle, middle),
            (side - middle, middle),
            (side - middle, side - middle),
            (middle, side - middle),
        ]
        way = (*corners, corners[0])
        legs = [Leg(tuple(way))]
        if both_ways:
            legs.append(Leg(tuple(reversed(way))))
        outer = _niches(rng, side, 0.0, -1.0)
        inner = _niches(rng, side - 6.0, 3.0, 1.0)
        return World.from_parts([*outer, *inner]), tuple(legs)

    return plan


def _niches(rng: np.random.Generator, side: float, offset: float, inwards: float) -> list[Array]:
    """Four walls of a square with niches 0.9 m wide; inwards 1: they lead into the square."""
    walls = []
    for quarter in range(4):
        points, at = [(0.0, 0.0)], rng.uniform(1.0, 6.0)
        while at < side - 2.0:
            depth = inwards * rng.uniform(0.1, 0.4)
            points += [(at, 0.0), (at, depth), (at + 0.9, depth), (at + 0.9, 0.0)]
            at += rng.uniform(2.0, 8.0)
        corners = np.array([*points, (side, 0.0)])
        angle = 0.5 * np.pi * quarter
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        middle = 0.5 * side
        walls.append(polyline((corners - middle) @ turn + middle + offset))
    return walls


def _trees(rng: np.random.Generator, count: int, size: float, path: tuple[Leg, ...]) -> list[Array]:
    """Trunks anywhere in a square, off the path."""
    way, found = way_points(path), list[Array]()
    while len(found) < count:
        x, y = rng.uniform(0.0, size, 2)
        trunk = pillar(float(x), float(y), float(rng.uniform(*TREE_M)), sides=12)
        if keeps_off(trunk, way, OFF_THE_PATH_M):
            found.append(trunk)
    return found
