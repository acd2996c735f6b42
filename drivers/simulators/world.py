"""A flat world of wall segments, and what a range finder would measure in it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from gtsam import Pose2
from numpy.typing import ArrayLike, NDArray
from slam.drivers.simulators.ray_casting import cast_from_each_beam, cast_from_point

Array = NDArray[np.float64]


def _no_segments() -> Array:
    return np.empty((0, 4))


@dataclass(frozen=True, eq=False)
class World:
    """Straight walls without thickness, in the world frame; the arrays are copied and read-only.

    A beam that meets a pane of glass first brings nothing back: it neither returns nor
    passes through, as on a pane or a mirror met at an angle.  A wall seen exactly edge-on
    is invisible; a laser that stands on a wall reads 0 all round.

    Raises:
        ValueError: if a coordinate is not finite.
    """

    segments: Array = field(default_factory=_no_segments)  # (n, 4) m: x1, y1, x2, y2
    panes: Array = field(default_factory=_no_segments)  # (m, 4) m: the same, of glass

    def __post_init__(self) -> None:
        """Copy and freeze the arrays: a world is shared between drives."""
        for name in ("segments", "panes"):
            values = np.array(getattr(self, name), dtype=np.float64).reshape(-1, 4)
            if not np.isfinite(values).all():
                raise ValueError(f"{name} need finite coordinates")
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    @classmethod
    def from_polygon(cls, corners: ArrayLike) -> World:
        """Close the outline through `corners`, (n, 2) in metres, the last joined to the first."""
        start = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        return cls(np.hstack([start, np.roll(start, -1, axis=0)]))

    @classmethod
    def from_parts(cls, parts: Iterable[Array]) -> World:
        """Gather solid walls given as any number of (k, 4) arrays."""
        return cls(np.vstack([_no_segments(), *parts]))

    @classmethod
    def joined(cls, worlds: Iterable[World]) -> World:
        """Put several worlds of the same frame into one."""
        worlds = list(worlds)
        return cls(
            np.vstack([_no_segments(), *(world.segments for world in worlds)]),
            np.vstack([_no_segments(), *(world.panes for world in worlds)]),
        )

    def moved(self, world_T_old: Pose2) -> World:
        """Return the same walls with the old frame placed at `world_T_old`."""
        return World(_moved(world_T_old, self.segments), _moved(world_T_old, self.panes))

    def cast(self, world_T_laser: Pose2, bearings: Array, range_max: float) -> Array:
        """Return the exact range along each bearing, inf where nothing is within `range_max`.

        `bearings` is (n,) rad in the laser frame, monotone either way, over one turn at
        most (ValueError otherwise).
        """
        if len(bearings) == 0:
            return np.empty(0)
        clockwise = bool(bearings[0] > bearings[-1])
        ascending = np.ascontiguousarray(bearings[::-1] if clockwise else bearings)
        if not _sweeps_once(ascending):
            raise ValueError("bearings must be monotone and span one turn at most")
        pose = (world_T_laser.x(), world_T_laser.y(), world_T_laser.theta())
        ranges = cast_from_point(self._all(), len(self.segments), *pose, ascending, range_max)
        return np.ascontiguousarray(ranges[::-1] if clockwise else ranges)

    def cast_moving(self, world_T_lasers: Array, bearings: Array, range_max: float) -> Array:
        """Cast each beam from its own pose, rows of `world_T_lasers` (n, 3): x, y, theta.

        For sweeps taken on the move.  Every beam meets every wall, so this is several
        times slower than `cast`.
        """
        angles = world_T_lasers[:, 2] + bearings
        origins = np.ascontiguousarray(world_T_lasers[:, :2])
        return np.asarray(
            cast_from_each_beam(self._all(), len(self.segments), origins, angles, range_max)
        )

    def clearance(self, points: Array) -> Array:
        """Return the distance from each of `points`, (n, 2) in m, to the nearest wall, (n,)."""
        nearest = np.full(len(points), np.inf)
        for x1, y1, x2, y2 in self._all():
            start, along = np.array([x1, y1]), np.array([x2 - x1, y2 - y1])
            share = (points - start) @ along / max(along @ along, 1e-300)
            foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
            np.minimum(nearest, np.linalg.norm(points - foot, axis=1), out=nearest)
        return nearest

    def _all(self) -> Array:
        return np.vstack([self.segments, self.panes])


def _moved(world_T_old: Pose2, segments: Array) -> Array:
    ends = np.asfortranarray(segments.reshape(-1, 2).T)  # gtsam takes columns
    return np.asarray(world_T_old.transformFrom(ends)).T.reshape(-1, 4)


def _sweeps_once(ascending: Array) -> bool:
    span = float(ascending[-1] - ascending[0])
    return bool(np.all(np.diff(ascending) > 0)) and span <= 2 * np.pi + 1e-9
