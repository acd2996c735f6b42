"""A robot whose sizes are not those that its odometry is computed with, message by message."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.logs.messages import LaserExtrinsics, SensorMessage, WheelOdometry

TRACK_M = 0.357  # of a P3-DX, as its DiffConvFactor has it (docs/devices.md)


@dataclass(frozen=True, kw_only=True, slots=True)
class Miscalibration:
    """What is true of a robot, against what its log and its odometry take for true."""

    left_scale: float = 1.0  # true size of the left wheel over the size it is taken for
    right_scale: float = 1.0
    track_scale: float = 1.0  # true distance between the wheels over that taken
    track_m: float = TRACK_M  # m, taken
    odometry_delay_s: float = 0.0  # by which the odometry's stamps are late
    stated: tuple[float, float, float] | None = None  # base_T_laser in the log; None: the true

    def __post_init__(self) -> None:
        """Refuse wheels without size."""
        if min(self.left_scale, self.right_scale, self.track_scale, self.track_m) <= 0.0:
            raise ValueError("sizes of wheels and track must be positive")

    @property
    def true_from_counted(self) -> NDArray[np.float64]:
        """(2, 2): the robot's (forward m, turn rad) from those of its odometry."""
        mean = 0.5 * (self.left_scale + self.right_scale)
        apart = self.right_scale - self.left_scale
        track = self.track_scale * self.track_m
        return np.array(
            [[mean, 0.25 * apart * self.track_m], [apart / track, mean / self.track_scale]]
        )

    def apply(self, messages: Iterable[SensorMessage]) -> Iterator[SensorMessage]:
        """The log that such a robot records; odometry comes when its stamp says."""
        waiting: deque[WheelOdometry] = deque()
        for message in self._counted(messages):
            if isinstance(message, WheelOdometry):
                waiting.append(message)
                continue
            while waiting and waiting[0].stamp_ns <= message.stamp_ns:
                yield waiting.popleft()
            if isinstance(message, LaserExtrinsics) and self.stated is not None:
                message = LaserExtrinsics(message.stamp_ns, *self.stated)
            yield message
        yield from waiting

    def _counted(self, messages: Iterable[SensorMessage]) -> Iterator[SensorMessage]:
        inverse = np.linalg.inv(self.true_from_counted)
        late_ns = round(self.odometry_delay_s * 1e9)
        last: Pose2 | None = None
        counted = Pose2()
        for message in messages:
            if not isinstance(message, WheelOdometry):
                yield message
                continue
            pose = Pose2(message.x, message.y, message.theta)
            if last is not None:
                forward, left, turn = Pose2.Logmap(last.between(pose))
                step = inverse @ (forward, turn)
                counted = counted * Pose2.Expmap(np.array([step[0], left, step[1]]))
            last = pose
            yield replace(
                message, stamp_ns=message.stamp_ns + late_ns,
                x=counted.x(), y=counted.y(), theta=counted.theta(),
            )  # fmt: skip
