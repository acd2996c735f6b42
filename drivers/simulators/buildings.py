"""Office worlds: a ring corridor round a core, rooms outside it, doors and furniture."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from slam.drivers.simulators.corridors import Plan
from slam.drivers.simulators.outlines import (
    Array,
    Door,
    Point,
    box,
    keeps_off,
    ring,
    thick_wall,
    way_points,
)
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World

KEEP_OFF = 0.6  # m between furniture and the path


@dataclass(frozen=True, kw_only=True, slots=True)
class RingBuilding:
    """Measures of a rectangular office floor, south-west corner at (0, 0)."""

    length: float  # m along x
    width: float  # m along y
    room_depth: float  # m from the facade to the corridor's outer wall
    lane: float  # m, width of the corridor
    rooms_long: int  # rooms on each long side, corner rooms included
    rooms_short: int  # rooms on each short side, between the corner rooms
    loops: int  # times round the corridor

    @property
    def middle(self) -> tuple[Point, Point]:
        """South-west and north-east corner of the corridor's middle line."""
        inset = self.room_depth + 0.5 * self.lane
        return (inset, inset), (self.length - inset, self.width - inset)


OFFICE = RingBuilding(
    length=22.0, width=16.0, room_depth=4.5, lane=1.9, rooms_long=4, rooms_short=2, loops=1
)
OFFICE_RING = RingBuilding(
    length=40.0, width=25.0, room_depth=5.0, lane=2.0, rooms_long=7, rooms_short=3, loops=2
)


def office(rng: np.random.Generator) -> Plan:
    """A small floor: once round, into a room on either side, and back to the start."""
    return _ring_building(OFFICE, rng)


def office_ring(rng: np.random.Generator) -> Plan:
    """A floor of 40 by 25 m: twice round the corridor, a room on each lap."""
    return _ring_building(OFFICE_RING, rng)


def _ring_building(plan: RingBuilding, rng: np.random.Generator) -> Plan:
    low, high = plan.room_depth, plan.width - plan.room_depth
    cuts = [_cuts(rng, plan.length, plan.rooms_long, plan.room_depth + 2.5) for _ in range(2)]
    south, north = (_doors(rng, c, (plan.room_depth, plan.length - plan.room_depth)) for c in cuts)
    parts = [
        ring([(0, 0), (plan.length, 0), (plan.length, plan.width), (0, plan.width)]),
        thick_wall((0.0, low), (plan.length, low), south),
        thick_wall((0.0, high), (plan.length, high), north),
        *(thick_wall((x, 0.0), (x, low)) for x in cuts[0]),
        *(thick_wall((x, high), (x, plan.width)) for x in cuts[1]),
        *_short_side(plan, rng, 0.0, plan.room_depth, plan.room_depth),
        *_short_side(
            plan, rng, plan.length - plan.room_depth, plan.length, plan.length - plan.room_depth
        ),
        *_core(plan, rng),
    ]
    path = _path(plan, south[len(south) // 2].at, north[len(north) // 2].at)
    parts += _furniture(plan, rng, World(np.vstack(parts)), way_points(path))
    return World(np.vstack(parts)), path


def _cuts(rng: np.random.Generator, length: float, rooms: int, corner: float) -> list[float]:
    """Place the walls between `rooms` rooms, the corner rooms at least `corner` long."""
    even = np.linspace(corner, length - corner, rooms - 1)
    slack = 0.15 * (even[1] - even[0]) if rooms > 2 else 0.0
    return [float(x) for x in even + rng.uniform(-slack, slack, rooms - 1).clip(-0.5, 0.5)]


def _doors(rng: np.random.Generator, cuts: list[float], reach: Point) -> list[Door]:
    """Give each room a door on the corridor; that of the middle room stands open."""
    ends = [reach[0], *cuts, reach[1]]
    doors = []
    for k, (near, far) in enumerate(pairwise(ends)):
        closed = bool(rng.random() < 0.4) and k != (len(ends) - 1) // 2
        doors.append(Door(float(rng.uniform(near + 0.8, far - 0.8)), closed=closed))
    return doors


def _short_side(
    plan: RingBuilding, rng: np.random.Generator, x1: float, x2: float, wall_x: float
) -> list[Array]:
    """Draw the rooms of the west or east side between x1 and x2, with their corridor wall."""
    low, high = plan.room_depth, plan.width - plan.room_depth
    cuts = np.linspace(low, high, plan.rooms_short + 1)[1:-1]
    doors = [
        Door(d.at - low, closed=d.closed)
        for d in _doors(rng, [float(y) for y in cuts], (low, high))
    ]
    wall = thick_wall((wall_x, low), (wall_x, high), doors)
    return [wall, *(thick_wall((x1, float(y)), (x2, float(y))) for y in cuts)]


def _core(plan: RingBuilding, rng: np.random.Generator) -> list[Array]:
    """Draw the four walls of the core; all its doors are shut."""
    inset = plan.room_depth + plan.lane
    x1, y1, x2, y2 = inset, inset, plan.length - inset, plan.width - inset
    corners = [(x1, y1), (x2, y1), (x2, y2), (x1, y2), (x1, y1)]
    walls = []
    for start, end in pairwise(corners):
        side = abs(end[0] - start[0]) + abs(end[1] - start[1])
        places = np.arange(1.2, side - 1.2, 4.0)
        doors = [
            Door(float(at + rng.uniform(0.0, 1.2)), closed=True) for at in places if side > 4.0
        ]
        walls.append(thick_wall(start, end, [d for d in doors if d.at < side - 0.7]))
    return walls


def _path(plan: RingBuilding, south_door: float, north_door: float) -> tuple[Leg, ...]:
    """Round the ring; into a room by the south door, on the last lap by the north one.

    The robot backs out of both.  Each lap runs a little nearer to the core, so that no
    place is seen twice from quite the same point.
    """
    (x1, y1), (x2, y2) = plan.middle
    legs, start = [], (south_door, y1)
    for lap in range(plan.loops):
        shift = 0.25 * lap
        w, s, e, n = x1 + shift, y1 + shift, x2 - shift, y2 - shift
        if lap == 0:
            legs += _visit((max(w, south_door - 3.0), s), start, -1.0)
        if lap == plan.loops - 1:
            legs += _visit(legs[-1].points[-1], (north_door, n), 1.0, [(e, s), (e, n)])
            legs.append(Leg(((north_door, n), (w, n), (w, s), start)))
        else:
            legs.append(Leg((start, (e, s), (e, n), (w, n), (w, s), start)))
    return tuple(legs)


def _visit(
    start: Point, front: Point, side: float, between: list[Point] | None = None
) -> list[Leg]:
    """Drive from `start` to the `front` of a door, on into the room, and back out."""
    inside = (front[0], front[1] + 3.0 * side)
    return [
        Leg((start, *(between or ()), front)),
        Leg((front, inside)),
        Leg((inside, front), reverse=True),
    ]


def _furniture(
    plan: RingBuilding, rng: np.random.Generator, walls: World, keep_off: Array
) -> list[Array]:
    """Scatter desks and cabinets over the rooms, clear of walls, path and each other."""
    pieces: list[Array] = []
    for _ in range(int(0.25 * plan.length * plan.width)):
        x, y = rng.uniform(0.6, plan.length - 0.6), rng.uniform(0.6, plan.width - 0.6)
        piece = box(x, y, rng.uniform(0.4, 1.5), rng.uniform(0.3, 0.7), _upright(rng))
        if not _in_room(plan, x, y) or not keeps_off(piece, keep_off, KEEP_OFF):
            continue
        outline = way_points([Leg(tuple(map(tuple, piece[[0, 1, 2, 3, 0], :2])))])
        if World.joined([walls, World.from_parts(pieces)]).clearance(outline).min() > 0.05:
            pieces.append(piece)
    return pieces


def _upright(rng: np.random.Generator) -> float:
    """Draw a heading: most furniture stands square, chairs and trolleys do not."""
    return float(rng.integers(2) * 0.5 * np.pi if rng.random() < 0.7 else rng.uniform(0.0, np.pi))


def _in_room(plan: RingBuilding, x: float, y: float) -> bool:
    depth = min(x, y, plan.length - x, plan.width - y)
    return bool(depth < plan.room_depth - 0.9)
