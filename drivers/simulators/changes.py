"""A building some days later: part of what stands about in it has been moved."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.outlines import keeps_off, way_points
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import Scenario

Array = NDArray[np.float64]

LARGEST_M = 2.0  # m across: what is larger is part of the building
FARTHEST_M = 1.5  # m by which a thing is moved
KEEP_OFF_M = 0.5  # m between a thing and the robot's way
TRIES = 10


def with_things_moved(scenario: Scenario, share: float, seed: int) -> Scenario:
    """Move so large a share of the crates, pillars and furniture, and turn them anyhow.

    A thing is a closed outline no larger than LARGEST_M; the way stays free.  A thing that finds
    no other place is taken away.
    """
    rng = np.random.default_rng([seed, 21])
    segments, way = scenario.world.segments, way_points(scenario.path)
    parts: list[Array] = []
    for first, last in _outlines(segments):
        outline = segments[first:last]
        if _is_thing(outline) and rng.random() < share:
            parts += _moved(outline, way, rng)
        else:
            parts.append(outline)
    world = World(np.vstack(parts), scenario.world.panes)
    return Scenario(scenario.name, world, scenario.path)


def _outlines(segments: Array) -> list[tuple[int, int]]:
    """First and one past the last of each run of segments that join end to end."""
    joined = np.all(segments[1:, :2] == segments[:-1, 2:], axis=1)
    starts = [0, *(np.flatnonzero(~joined) + 1).tolist(), len(segments)]
    return list(pairwise(starts))


def _is_thing(outline: Array) -> bool:
    closed = bool(np.all(outline[0, :2] == outline[-1, 2:])) and len(outline) > 2
    size = np.ptp(outline[:, :2], axis=0)
    return closed and bool(np.hypot(*size) < LARGEST_M)


def _moved(outline: Array, way: Array, rng: np.random.Generator) -> list[Array]:
    corners = outline[:, :2]
    middle = corners.mean(axis=0)
    for _ in range(TRIES):
        angle, shift = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-FARTHEST_M, FARTHEST_M, 2)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        placed = (corners - middle) @ turn + middle + shift
        thing = np.hstack([placed, np.roll(placed, -1, axis=0)])
        if keeps_off(thing, way, KEEP_OFF_M):
            return [thing]
    return []
