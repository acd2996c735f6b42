"""Whether the matches of the last metres and the odometry tell of the same way.

A match that slides along a wall goes a little against the odometry at every scan, and each step
could be right; all of them together could not.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from gtsam import Pose2

from slam.mapping.localisation.hypothesis import MAP_ERROR
from slam.mapping.odometry import OdometryConfig
from slam.mapping.scan_sync import OdometryIncrement, StampedScan

WAY_M = 2.0  # m that are looked back: there the odometry is still better than a sliding match
SPACING_M = 0.2  # m between two poses that are remembered
# Probability of an odometry fault on such a way, whose disagreement says nothing of the pose.
FAULT_SHARE = 0.01
DEGREES_OF_FREEDOM = 3.0


class InnovationCheck:
    """Remembers where the robot was found on the last metres."""

    def __init__(self, config: OdometryConfig) -> None:
        self._config = config
        self._past: deque[tuple[StampedScan, Pose2]] = deque(maxlen=round(WAY_M / SPACING_M) + 1)

    def forget(self) -> None:
        """The robot has been found anew."""
        self._past.clear()

    def nats(self, stamped: StampedScan, map_T_base: Pose2) -> float:
        """Log of how likely the way since is if the pose is right, over any other way; 0 at best.

        Both poses may be off by the map's error.
        """
        evidence = 0.0
        if self._past:
            first, pose = self._past[0]
            way = OdometryIncrement(first, stamped)
            error = np.asarray(Pose2.Logmap(way.moved.between(pose.between(map_T_base))))
            covariance = self._config.covariance(way.path_m, way.path_rad, way.seconds)
            distance2 = float(error @ np.linalg.solve(covariance + 2.0 * MAP_ERROR, error))
            surplus = min(0.0, 0.5 * (DEGREES_OF_FREEDOM - distance2))
            evidence = math.log((1.0 - FAULT_SHARE) * math.exp(surplus) + FAULT_SHARE)
        if not self._past or stamped.path_m - self._past[-1][0].path_m >= SPACING_M:
            self._past.append((stamped, map_T_base))
        return evidence
