"""A calibration of the robot, and the messages as it corrects them.

Wheels whose sizes and track are not what the odometry was computed with report another way and
another turn: both are linear in what is true (Censi, Franchi, Marchionni and Oriolo, T-RO 2013).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.logs.messages import LaserExtrinsics, Message, WheelOdometry


class CalibrationConfig(BaseModel):
    """Where the laser sits, and what is wrong with the odometry, as `slam calibrate` finds it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    laser_x: float | None = Field(
        None, allow_inf_nan=False, description="m ahead of the wheel axis, instead of the log's"
    )
    laser_y: float | None = Field(
        None, allow_inf_nan=False, description="m to the left, instead of the log's"
    )
    laser_yaw_deg: float | None = Field(
        None, allow_inf_nan=False, description="deg anticlockwise, instead of the log's"
    )
    translation_scale: float = Field(1.0, gt=0, description="true m per m of the odometry")
    rotation_scale: float = Field(1.0, gt=0, description="true rad per rad of the odometry")
    curvature: float = Field(
        0.0, allow_inf_nan=False, description="rad that the robot truly turns per m of odometry "
        "straight ahead: unequal wheels",
    )  # fmt: skip
    odometry_track_m: float = Field(
        0.0, ge=0, description="m, track width that the odometry was computed with; 0: unknown"
    )
    time_offset_s: float = Field(
        0.0, ge=-10, le=10, description="s to add to the odometry's stamps, for the laser's clock"
    )

    @cached_property
    def wheels(self) -> NDArray[np.float64]:
        """(2, 2): true (forward, turn) from those of the odometry."""
        return wheel_matrix(
            self.translation_scale, self.rotation_scale, self.curvature, self.odometry_track_m
        )

    @property
    def corrects_odometry(self) -> bool:
        """Whether it changes any reading."""
        return bool(self.time_offset_s) or not np.array_equal(self.wheels, np.eye(2))

    def true_step(self, step: Pose2) -> Pose2:
        """What a step of the odometry stands for; small enough to be an arc."""
        forward, left, turn = Pose2.Logmap(step)
        wheels = self.wheels
        true_forward, true_turn = wheels @ (forward, turn)
        return Pose2.Expmap(np.array([true_forward, wheels[0, 0] * left, true_turn]))

    def mount(self, stated: LaserExtrinsics) -> LaserExtrinsics:
        """The laser's place, the stated one where this says nothing."""
        yaw = self.laser_yaw_deg
        return LaserExtrinsics(
            stated.stamp_ns,
            stated.x if self.laser_x is None else self.laser_x,
            stated.y if self.laser_y is None else self.laser_y,
            stated.theta if yaw is None else math.radians(yaw),
        )


def mount_in_force(stated: LaserExtrinsics, settings: Mapping[str, Any]) -> LaserExtrinsics:
    """Where a run with such settings (of its `config.json`) had the laser; `stated` by its log.

    The recording in a run of `slam online` has the mount as it was stated.
    """
    return CalibrationConfig.model_validate(settings.get("calibration", {})).mount(stated)


def wheel_matrix(
    translation: float, rotation: float, curvature: float, track_m: float
) -> NDArray[np.float64]:
    """(2, 2): true (forward m, turn rad) from those that an odometry counts.

    Wheels of k_l and k_r times the nominal size on a track of b instead of b0 give
    forward = (k_l + k_r) / 2 d + (k_r - k_l) b0 / 4 a  and
    turn = (k_r - k_l) / b d + (k_l + k_r) / 2 b0 / b a.  Where b0 (`track_m`) is not known (0),
    the small term that turns into a way is left to the laser's y, which it looks like.
    """
    across = curvature * track_m**2 * translation / (4.0 * rotation)
    return np.array([[translation, across], [curvature, rotation]])


class Corrector:
    """Takes messages as they come and gives them as the calibration has them."""

    def __init__(self, config: CalibrationConfig) -> None:
        self._config = config
        self._last: Pose2 | None = None  # as it came
        self._pose = Pose2()  # as it goes
        self._idle = not config.corrects_odometry

    def __call__(self, message: Message) -> Message:
        """The message corrected; the same object where there is nothing to correct."""
        if isinstance(message, LaserExtrinsics):
            return self._config.mount(message)
        if isinstance(message, WheelOdometry) and not self._idle:
            return self._odometry(message)
        return message

    def _odometry(self, message: WheelOdometry) -> WheelOdometry:
        pose = Pose2(message.x, message.y, message.theta)
        if self._last is None:
            self._pose = pose
        else:
            self._pose = self._pose * self._config.true_step(self._last.between(pose))
        self._last = pose
        stamp_ns = message.stamp_ns + round(self._config.time_offset_s * 1e9)
        return WheelOdometry(stamp_ns, self._pose.x(), self._pose.y(), self._pose.theta())
