"""What is kept of every scan, keyframe or not: when it was taken, and what the wheels said."""

from __future__ import annotations

from array import array

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

Motion = tuple[float, float, float]  # x, y (m), theta (rad)


class ScanHistory:
    """Stamps and odometry of all scans so far, 32 bytes each: a robot may stand for days."""

    def __init__(self) -> None:
        self._stamps_ns = array("q")
        self._odometry = array("d")
        self._sweeps = array("d")

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def append(self, stamp_ns: int, odom_T_base: Pose2, sweep: Motion | None = None) -> None:
        """Add a scan; `sweep` is the motion while it was taken, given for all scans or none."""
        self._stamps_ns.append(stamp_ns)
        self._odometry.extend((odom_T_base.x(), odom_T_base.y(), odom_T_base.theta()))
        if sweep is not None:
            self._sweeps.extend(sweep)

    def pop(self) -> None:
        """Forget the last scan."""
        self._stamps_ns.pop()
        del self._odometry[-3:], self._sweeps[3 * len(self._stamps_ns) :]

    @property
    def last_ns(self) -> int:
        """Stamp of the last scan."""
        return self._stamps_ns[-1]

    @property
    def last_odometry(self) -> Pose2:
        """odom_T_base of the last scan."""
        return Pose2(*self._odometry[-3:])

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(n,) stamps, a copy."""
        return np.array(self._stamps_ns, dtype=np.int64)

    @property
    def odom_poses(self) -> NDArray[np.float64]:
        """(n, 3) odom_T_base [x, y, theta], a copy."""
        return np.array(self._odometry).reshape(-1, 3)

    def sweep(self, k: int) -> Motion | None:
        """The motion while scan `k` was taken; None where sweeps are not looked at."""
        if not self._sweeps:
            return None
        x, y, theta = self._sweeps[3 * k : 3 * k + 3]
        return x, y, theta
