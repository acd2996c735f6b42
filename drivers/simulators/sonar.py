"""The sixteen sonars of a P3-DX (docs/devices.md, section 3)."""

from __future__ import annotations

import numpy as np
from gtsam import Pose2
from slam.drivers.simulators.motion import Motion
from slam.drivers.simulators.world import World

_BEARINGS = np.radians(
    [90, 50, 30, 10, -10, -30, -50, -90, -90, -130, -150, -170, 170, 150, 130, 90]
)
_REACH_M = 5.0  # farther is reported as 5000: no echo


def echoes(motion: Motion, world: World | None, now_s: float) -> tuple[tuple[int, int], ...]:
    """Return number and mm of each sonar, all of them seen from the middle of the robot."""
    ranges = np.full(len(_BEARINGS), _REACH_M)
    if world is not None:
        pose = Pose2(*motion.truth(np.array([now_s]))[0].tolist())
        apart = _BEARINGS + 1e-6 * np.arange(len(_BEARINGS))  # two look the same way
        order = np.argsort(apart)
        ranges[order] = np.minimum(world.cast(pose, apart[order], _REACH_M), _REACH_M)
    return tuple((i, round(r * 1000.0)) for i, r in enumerate(ranges.tolist()))
