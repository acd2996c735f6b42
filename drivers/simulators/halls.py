"""Worlds where walls are no help: a cluttered hall, and a mixture of hall and corridor."""

from __future__ import annotations

import numpy as np
from slam.drivers.simulators.corridors import Plan
from slam.drivers.simulators.outlines import (
    Array,
    Recess,
    box,
    keeps_off,
    pillar,
    polyline,
    recessed_wall,
    way_points,
)
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

SPACING = 1.1  # m, least distance between the middles of two things
KEEP_OFF = 0.6  # m between things and the path


def clutter(rng: np.random.Generator) -> Plan:
    """A hall of 40 by 30 m whose walls nobody sees: crates and pillars only, turned anyhow."""
    loop = [(8.0, 15.0), (12.0, 7.0), (28.0, 7.0), (32.0, 15.0), (28.0, 23.0), (12.0, 23.0)]
    inner = [(20.0 + 0.96 * (x - 20.0), 15.0 + 0.96 * (y - 15.0)) for x, y in loop]
    path = (
        Leg((*loop, loop[0], loop[1])),
        Leg((loop[1], (10.0, 11.0)), reverse=True),
        Leg(((10.0, 11.0), inner[1], (20.0, 15.0), *inner[4:], inner[0], loop[1])),
    )
    things = _scattered(rng, (1.0, 1.0, 39.0, 29.0), 170, way_points(path))
    return World(np.vstack(things)), path


def mixed(rng: np.random.Generator) -> Plan:
    """A loop through a corridor with doors, a cluttered hall and a corridor glazed on one side."""
    path = (
        Leg(((-1.0, 0.0), (14.0, 0.0), (20.0, 0.5), (26.0, 2.0))),
        Leg(((26.0, 2.0), (24.0, 1.4)), reverse=True),
        Leg(((24.0, 1.4), (24.0, 7.0), (20.0, 8.0), (-1.0, 8.0), (-1.0, 0.0), (6.0, 0.0))),
    )
    walls = [
        recessed_wall((-2.0, -1.0), (16.0, -1.0), _doors(rng, 18.0, -1.0)),
        recessed_wall((16.0, 1.0), (0.0, 1.0), _doors(rng, 16.0, -1.0)),
        recessed_wall((0.0, 1.0), (0.0, 7.0), ()),
        recessed_wall((0.0, 7.0), (16.0, 7.0), _doors(rng, 16.0, -1.0)),
        recessed_wall((-2.0, 9.0), (-2.0, -1.0), _doors(rng, 10.0, -1.0)),
        polyline(
            [(16.0, -1.0), (16.0, -6.0), (32.0, -6.0), (32.0, 14.0), (16.0, 14.0), (16.0, 9.0)]
        ),
        polyline([(16.0, 1.0), (16.0, 7.0)]),
    ]
    panes = polyline([(16.0, 9.0), (-2.0, 9.0)])
    things = _scattered(rng, (17.0, -5.0, 31.0, 13.0), 40, way_points(path))
    return World(np.vstack(walls + things), panes), path


def _doors(rng: np.random.Generator, length: float, side: float) -> list[Recess]:
    places = np.arange(1.5, length - 2.0, 3.5)
    return [
        Recess(float(at + rng.uniform(0.0, 1.5)), 0.9, side * float(rng.uniform(0.1, 0.3)))
        for at in places
    ]


def _scattered(
    rng: np.random.Generator, area: tuple[float, float, float, float], count: int, keep_off: Array
) -> list[Array]:
    """Place up to `count` crates and pillars in `area` (x1, y1, x2, y2), apart and off the path."""
    things: list[Array] = []
    middles = np.empty((0, 2))
    for _ in range(20 * count):
        if len(things) == count:
            break
        middle = rng.uniform(area[:2], area[2:])
        thing = _thing(rng, float(middle[0]), float(middle[1]))
        apart = bool(np.all(np.hypot(*(middles - middle).T) >= SPACING))
        if apart and keeps_off(thing, keep_off, KEEP_OFF):
            things.append(thing)
            middles = np.vstack([middles, middle])
    return things


def _thing(rng: np.random.Generator, x: float, y: float) -> Array:
    if rng.random() < 0.4:
        return pillar(x, y, float(rng.uniform(0.08, 0.3)))
    size = rng.uniform(0.2, 0.7, 2)
    return box(x, y, float(size[0]), float(size[1]), float(rng.uniform(0.0, np.pi)))
