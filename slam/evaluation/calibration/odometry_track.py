"""The odometry of a whole drive, as a calibration would correct it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import compose, logmap, unwrapped_between

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OdometryTrack:
    """Poses at growing times; between two readings the robot moves along an arc."""

    times_s: Array  # (n,) s, growing
    poses: Array  # (n, 3) odom_T_base: x, y (m), theta (rad)

    @cached_property
    def twists(self) -> Array:
        """(n - 1, 3) forward (m), left (m) and turn (rad) from each reading to the next."""
        return logmap(unwrapped_between(self.poses[:-1], self.poses[1:]))

    def corrected(self, wheels: Array) -> OdometryTrack:
        """The track whose (forward, turn) are `wheels`, (2, 2), times those of this one.

        What a robot that cannot move sideways counts as such is scaled like its way.
        """
        twists = self.twists
        changed = np.empty_like(twists)
        changed[:, [0, 2]] = twists[:, [0, 2]] @ wheels.T
        changed[:, 1] = twists[:, 1] * wheels[0, 0]
        return _chained(self.times_s, changed)

    def at(self, times_s: Array) -> Array:
        """(m, 3) poses at times within the track; at its ends beyond."""
        last = len(self.times_s) - 2
        k = np.clip(np.searchsorted(self.times_s, times_s, "right") - 1, 0, last)
        share = (times_s - self.times_s[k]) / (self.times_s[k + 1] - self.times_s[k])
        part = np.clip(share, 0.0, 1.0)[:, None] * self.twists[k]
        return compose(self.poses[k], expmap(part))

    @cached_property
    def path(self) -> tuple[Array, Array]:
        """(n,) m driven and (n,) rad turned, without sign, up to each reading."""
        way, turn = np.hypot(self.twists[:, 0], self.twists[:, 1]), np.abs(self.twists[:, 2])
        return tuple(np.concatenate([[0.0], np.cumsum(one)]) for one in (way, turn))  # type: ignore[return-value]


def expmap(twists: Array) -> Array:
    """(n, 3) poses that twists (n, 3) lead to: arcs."""
    forward, left, turn = twists.T
    chord = np.sinc(0.5 * turn / np.pi)  # numpy's sinc has the pi in it
    cos, sin = chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn)
    return np.column_stack([cos * forward - sin * left, sin * forward + cos * left, turn])


def _chained(times_s: Array, twists: Array) -> OdometryTrack:
    theta = np.concatenate([[0.0], np.cumsum(twists[:, 2])])
    steps = expmap(twists)
    cos, sin = np.cos(theta[:-1]), np.sin(theta[:-1])
    x = np.concatenate([[0.0], np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])])
    track = OdometryTrack(times_s, np.column_stack([x, y, theta]))
    track.__dict__["twists"] = twists  # as they were given: nothing is lost by way of the poses
    return track
