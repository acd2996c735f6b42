"""Checks of odometry and of where the laser sits, as far as no scan matching is needed."""

from __future__ import annotations

import math
from collections.abc import Iterator

from slam.logs.findings import Finding, seconds
from slam.logs.messages import LaserExtrinsics, WheelOdometry

# Beyond what any indoor robot of this size does; the limits of one robot are in `[robot]`.
TOP_SPEED = 3.0  # m/s
TOP_TURN_RATE = 6.3  # rad/s
LEAST_STEP_M, LEAST_STEP_RAD = 0.1, 0.2
JITTER_S = 0.15  # by so much stamps may be off between neighbours
ALONE_S = 1.0  # without odometry for so long a scan is on its own
FAR_MOUNT_M = 1.0  # farther out than any P3-DX is wide or long


class OdometryCheck:
    """Odometry in file order, and the stamps of the scans among it."""

    def __init__(self) -> None:
        self._last: WheelOdometry | None = None
        self._messages = self._not_finite = self._jumps = self._alone = self._scans = 0
        self._farthest = (0.0, 0)  # m, stamp
        self._widest_rad = 0.0
        self._path_m = self._path_rad = 0.0
        self._asked = 0.0  # of the path, m or rad, when it was last asked for

    def feed(self, odometry: WheelOdometry) -> None:
        """Take in one message."""
        self._messages += 1
        if not math.isfinite(odometry.x + odometry.y + odometry.theta):
            self._not_finite += 1
            return
        last, self._last = self._last, odometry
        if last is None:
            return
        step_m = math.hypot(odometry.x - last.x, odometry.y - last.y)
        step_rad = abs(math.remainder(odometry.theta - last.theta, math.tau))
        self._path_m += step_m
        self._path_rad += step_rad
        time_s = max((odometry.stamp_ns - last.stamp_ns) * 1e-9, 0.0) + JITTER_S
        leaps = step_m > max(LEAST_STEP_M, TOP_SPEED * time_s)
        spins = step_rad > max(LEAST_STEP_RAD, TOP_TURN_RATE * time_s)
        if leaps or spins:
            self._jumps += 1
            self._farthest = max(self._farthest, (step_m, odometry.stamp_ns))
            self._widest_rad = max(self._widest_rad, step_rad)

    def moved(self) -> float:
        """Return how far it moved since this was last called (m, or rad if more)."""
        moved = max(self._path_m, self._path_rad)
        since, self._asked = moved - self._asked, moved
        return since

    def feed_scan(self, stamp_ns: int) -> None:
        """Take in a scan's stamp."""
        self._scans += 1
        if self._last is None or stamp_ns - self._last.stamp_ns > ALONE_S * 1e9:
            self._alone += 1

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        if not self._messages:
            yield Finding(
                "warning", "no-odometry", "/odom",
                "there is no odometry: the map rests on matching scans alone",
            )  # fmt: skip
            return
        if self._not_finite:
            yield Finding(
                "error", "odometry-not-finite", "/odom",
                f"{self._not_finite} poses are not finite", self._not_finite,
            )  # fmt: skip
        if self._jumps:
            yield Finding(
                "warning", "odometry-jump", "/odom",
                f"{self._jumps} jumps no robot could drive, up to {_metres(self._farthest[0])} and "
                f"{math.degrees(self._widest_rad):.0f} deg",
                self._jumps, self._farthest[1],
            )  # fmt: skip
        if self._messages > 10 and self._path_m == 0.0 and self._path_rad == 0.0:
            yield Finding(
                "warning", "odometry-still", "/odom", "the odometry never moves: is it connected?"
            )
        if self._alone > max(1, 0.01 * self._scans):
            yield Finding(
                "warning", "scans-alone", "/odom",
                f"{self._alone} of {self._scans} scans have no odometry within "
                f"{seconds(ALONE_S)} before them", self._alone,
            )  # fmt: skip


def _metres(value: float) -> str:
    return f"{value:.2f} m" if value < 1e4 else f"{value:.3g} m"


class MountCheck:
    """Where the laser sits on the robot."""

    def __init__(self) -> None:
        self._extrinsics: LaserExtrinsics | None = None
        self._changes = 0

    def feed(self, extrinsics: LaserExtrinsics) -> None:
        """Take in one message."""
        pose = (extrinsics.x, extrinsics.y, extrinsics.theta)
        last = self._extrinsics
        self._changes += last is not None and pose != (last.x, last.y, last.theta)
        self._extrinsics = extrinsics

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        extrinsics = self._extrinsics
        if extrinsics is None:
            yield Finding(
                "warning", "no-mount", "/tf",
                "the laser's place on the robot is not in the log: it is taken to sit on the axle",
            )  # fmt: skip
            return
        if self._changes:
            yield Finding(
                "error", "mount-changes", "/tf",
                f"the laser's place on the robot changes {self._changes} times: two lasers, or a "
                "laser that was moved; each scan is taken from the place last named",
                self._changes,
            )  # fmt: skip
        if not math.hypot(extrinsics.x, extrinsics.y) <= FAR_MOUNT_M or not math.isfinite(
            extrinsics.theta
        ):
            yield Finding(
                "warning", "mount-far", "/tf",
                f"the laser sits at ({extrinsics.x:.3g}, {extrinsics.y:.3g}) m, "
                "beyond the robot's outline: wrong units?",
            )  # fmt: skip
