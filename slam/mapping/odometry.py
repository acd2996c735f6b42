"""Wheel odometry: its poses at scan times, its error model, and the robot's limits."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Protocol

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.logs.messages import WheelOdometry


class Moving(Protocol):
    """Anything with a speed and a turn rate."""

    @property
    def speed(self) -> float:
        """m/s, without sign."""
        ...

    @property
    def turn_rate(self) -> float:
        """rad/s, without sign."""
        ...


class RobotLimits(BaseModel):
    """What the robot can do at most; the defaults are the P3-DX's absolute limits."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_speed: float = Field(2.2, gt=0, description="m/s; faster motion is a fault")
    max_turn_rate: float = Field(5.2, gt=0, description="rad/s; a faster turn is a fault")

    def can_move(self, steps: Iterable[Moving]) -> bool:
        """Whether no step is faster than the robot can move."""
        return all(
            step.speed <= self.max_speed and step.turn_rate <= self.max_turn_rate for step in steps
        )

    def reach(self, seconds: float) -> tuple[float, float]:
        """How far (m) the robot can move and turn (rad, at most half a turn) in that time."""
        return self.max_speed * seconds, min(self.max_turn_rate * seconds, math.pi)


class OdometryConfig(BaseModel):
    """Error model of the P3-DX's dead reckoning, per step between keyframes.

    No controlled figure exists for this robot; its manuals trust it for several metres and one
    or two revolutions, simulators assume 0.75 % to 5 %.  The defaults lie at the cautious end.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    use: bool = Field(True, description="use odometry where there is some; else the laser alone")
    trans_per_m: float = Field(0.05, ge=0, description="m of sigma per metre travelled")
    trans_per_rad: float = Field(0.03, ge=0, description="m of sigma per radian turned")
    rot_per_m: float = Field(0.03, ge=0, description="rad of sigma per metre travelled")
    rot_per_rad: float = Field(0.10, ge=0, description="rad of sigma per radian turned")
    trans_floor: float = Field(0.005, gt=0, description="m, sigma of a step of no length")
    rot_floor: float = Field(0.005, gt=0, description="rad, sigma of a step of no length")
    sync: float = Field(
        0.05, ge=0, description="s by which odometry and scan may disagree on what time it is"
    )
    lost_inflation: float = Field(
        10.0, ge=1, description="factor on the sigmas where neither odometry nor match is trusted"
    )

    def covariance(self, distance: float, turn: float, seconds: float) -> NDArray[np.float64]:
        """(3, 3) of (x, y, theta) of a step, in the frame where it ends.

        Args:
            distance: m travelled along the path.
            turn: rad turned along the path, without sign.
            seconds: that the step took.
        """
        late = self.sync / max(seconds, self.sync)  # share of the step that may belong elsewhere
        sigma_rot = np.hypot(
            self.rot_floor, self.rot_per_m * distance + (self.rot_per_rad + late) * turn
        )
        sigma_along = np.hypot(
            self.trans_floor,
            (self.trans_per_m + late) * distance + self.trans_per_rad * turn,
        )
        # Heading errors on the way swing the end of the step sideways.
        sigma_across = np.hypot(sigma_along, 0.5 * distance * sigma_rot)
        return np.diag([sigma_along**2, sigma_across**2, sigma_rot**2])


class OdometryBuffer:
    """The recent odometry, interpolated to any stamp within it."""

    def __init__(self, capacity: int = 4096) -> None:
        self._stamps: deque[int] = deque(maxlen=capacity)
        self._poses: deque[Pose2] = deque(maxlen=capacity)

    def __bool__(self) -> bool:
        return bool(self._stamps)

    @property
    def last_ns(self) -> int:
        """Stamp of the newest reading."""
        return self._stamps[-1]

    def add(self, message: WheelOdometry) -> bool:
        """Append a reading; False if it is not newer than the last one (and is ignored)."""
        if self._stamps and message.stamp_ns < self._stamps[-1]:
            return False
        pose = Pose2(message.x, message.y, message.theta)
        if self._stamps and message.stamp_ns == self._stamps[-1]:
            self._poses[-1] = pose
            return True
        self._stamps.append(message.stamp_ns)
        self._poses.append(pose)
        return True

    def at(self, stamp_ns: int) -> Pose2:
        """odom_T_base at a stamp; the nearest reading where the stamp lies outside."""
        k = len(self._stamps) - 1
        while k > 0 and self._stamps[k] > stamp_ns:
            k -= 1
        if k == len(self._stamps) - 1 or self._stamps[k] >= stamp_ns:
            return self._poses[k]
        span = self._stamps[k + 1] - self._stamps[k]
        share = (stamp_ns - self._stamps[k]) / span
        step = Pose2.Logmap(self._poses[k].between(self._poses[k + 1]))
        return self._poses[k] * Pose2.Expmap(share * step)
