"""`slam.Mapper`: scans in, map and poses out, without files or threads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import ArrayLike, NDArray

from slam.backend.se2 import compose
from slam.logs.messages import (
    LaserExtrinsics,
    LaserScan,
    Message,
    OccupancyMap,
    WheelOdometry,
)
from slam.logs.trajectory import Trajectory
from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.maps.occupancy import build_map
from slam.runs.offline import feed, finish
from slam.runs.replay import FinishedRun
from slam.runs.run import Run, pose_table

NS = 1_000_000_000


class Mapper:
    """Maps scan by scan.  Poses are (x, y, theta) in m, m, rad; `pose` is map_T_base.

    The scans are kept in memory, so that `finish` can place every one of them.
    """

    def __init__(
        self,
        laser_pose: Sequence[float] = (0.0, 0.0, 0.0),
        config: SlamConfig | None = None,
    ) -> None:
        """Begin an empty map.

        Args:
            laser_pose: base_T_laser, where the laser sits on the robot.
            config: settings; None takes the defaults.
        """
        self._slam = Slam(config or SlamConfig())
        self._alone: bool | None = None  # scans come without odometry
        self._messages: list[Message] = []
        x, y, theta = (float(value) for value in laser_pose)
        self._feed(LaserExtrinsics(0, x, y, theta))

    def add(
        self,
        stamp: float,
        ranges: ArrayLike,
        angle_min: float,
        angle_step: float,
        *,
        odometry: Sequence[float] | None = None,
        range_max: float = float("inf"),
    ) -> None:
        """Take in one scan, and the odometry of the same moment if there is any.

        Args:
            stamp: s, later than the one before.
            ranges: (n,) m; inf where nothing came back, nan where a reading is unusable.
            angle_min: rad, bearing of the first beam in the laser frame.
            angle_step: rad from beam to beam, anticlockwise.
            odometry: odom_T_base (x, y, theta) by the wheels; None maps by the laser alone.
            range_max: m, the reach of the laser.

        Raises:
            ValueError: a value is not finite, the shapes are wrong, or some scans have odometry
                and some have not.
        """
        stamp_ns = round(stamp * NS)
        alone = odometry is None
        x, y, theta = (
            float(value) for value in ((0.0, 0.0, 0.0) if odometry is None else odometry)
        )
        if self._alone not in (None, alone):
            raise ValueError("either every scan has odometry or none")
        read = np.array(ranges, dtype=np.float32)
        if read.ndim != 1 or not np.isfinite([x, y, theta, angle_min, angle_step]).all():
            raise ValueError("ranges must be (n,), odometry and angles finite numbers")
        self._alone = alone
        if not alone:
            self._feed(WheelOdometry(stamp_ns, x, y, theta))
        self._feed(LaserScan(stamp_ns, angle_min, angle_step, read, 0.0, range_max))

    @property
    def pose(self) -> tuple[float, float, float]:
        """map_T_base of the newest scan, by the last keyframe and the odometry since.

        By the laser alone, the first poses come after two seconds: until then odometry may come.

        Raises:
            ValueError: no scan could be used yet.
        """
        last, step = self._since_keyframe()
        pose = self._graph.pose(last) * step
        return pose.x(), pose.y(), pose.theta()

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(3, 3) of `pose`, of (x, y, theta) in the base frame: m^2, m rad, rad^2."""
        last, step = self._since_keyframe()
        turn = step.inverse().AdjointMap()
        way = float(np.hypot(step.x(), step.y()))
        odometry = self._slam.config.odometry.covariance(way, abs(step.theta()), np.inf)
        carried: NDArray[np.float64] = turn @ self._graph.marginal(last) @ turn.T
        return carried + odometry

    def trajectory(self) -> NDArray[np.void]:
        """(n,) poses of all scans as the graph has them now: `stamp_ns`, `x`, `y`, `theta`."""
        scans = self._slam.scans
        poses = self._slam.predicted_scans(self._graph.poses.copy()).poses
        return pose_table(Trajectory(scans.stamps_ns, poses))

    def occupancy(self) -> OccupancyMap:
        """The occupancy grid of the keyframes where the graph has them now."""
        extrinsics = self._slam.extrinsics
        base_T_laser = np.array([extrinsics.x, extrinsics.y, extrinsics.theta])
        poses = compose(self._graph.poses.copy(), base_T_laser)
        scans = [keyframe.scan for keyframe in self._slam.keyframes]
        return build_map(scans, poses, self._slam.config.map)

    def finish(self) -> Run:
        """Optimise everything once more and place every scan; nothing can be added after it.

        Raises:
            SlamError: there was no scan to map.
        """
        self._slam.finish_input()
        timing: dict[str, Any] = {"stages_s": {}}
        result = finish(self._slam, lambda: self._messages, [])
        return Run(FinishedRun(result, self._slam.config, "", "", timing, {}))

    @property
    def _graph(self) -> Any:
        if self._slam.graph is None:
            raise ValueError("no scan could be used yet")
        return self._slam.graph

    def _since_keyframe(self) -> tuple[int, Pose2]:
        """Index of the last keyframe and the odometry since, keyframe_T_now."""
        now = self._slam.odometry
        if not self._slam.keyframes or (now is None and not self._alone):
            raise ValueError("no scan could be used yet")
        last = self._slam.keyframes[-1]
        newest = Pose2(now.x, now.y, now.theta) if now else self._slam.scans.last_odometry
        return last.index, last.odom_T_base.between(newest)

    def _feed(self, message: Message) -> None:
        self._messages.append(message)
        feed(self._slam, message)
