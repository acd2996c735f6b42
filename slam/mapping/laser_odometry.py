"""Odometry from scans alone, for robots whose wheels tell nothing and for lasers carried by hand.

Each scan is registered to the last few that were kept, as a keyframe is: the robot is expected to
go on as it did, as far as its limits on acceleration say, and the same decision tells whether the
match or the expectation is trusted.  What comes out stands in for wheel odometry.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.frontend.agreement import agreement
from slam.frontend.deskew import SweepOrder, deskew, sweep_ns
from slam.frontend.match_types import Prior, Reference
from slam.logs.messages import LaserExtrinsics, LaserScan
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Preparer
from slam.mapping.registration import AFTER_FAULT, NEVER, OdometryEvidence, register
from slam.mapping.scan_sync import STAMP_JITTER_S, ScanWithOdometry

# Changes of speed that a robot makes or a hand that carries a laser: a person who begins to walk
# or to turn about does so in half a second.
ACCELERATION = 2.0  # m/s^2, one sigma
TURN_ACCELERATION = 5.0  # rad/s^2, one sigma
LEAST_SIGMA_M, LEAST_SIGMA_RAD = 0.02, 0.02  # of a step, however short
LONGEST_S = 1.0  # s for which the motion before tells anything
KEPT = 3  # scans that the next one is registered to
# A scan is kept when the last one has become this different: by its way, its turn, or by what of
# it can be seen there.
KEEP_AFTER_M, KEEP_AFTER_RAD, KEEP_BELOW = 0.3, 0.35, 0.7
LOST_S = 1.0  # s without a match, after which the scans kept are of no use any more


class LaserOdometry:
    """Places one scan after the other."""

    def __init__(self, config: SlamConfig, prepare: Preparer) -> None:
        self._config, self._prepare = config, prepare
        self._kept: deque[Reference] = deque(maxlen=KEPT)  # in the odometry frame
        self._pose = Pose2()  # odom_T_base of the last scan
        self._velocity: NDArray[np.float64] = np.zeros(3)  # m/s, m/s, rad/s in the base frame
        self._last_ns: int | None = None
        self._matched_ns = 0  # stamp of the last scan with a match
        self._broken_s = 0.0  # time without a match after which a new track was begun

    def place(
        self, scan: LaserScan, extrinsics: LaserExtrinsics, order: SweepOrder
    ) -> ScanWithOdometry:
        """Where the scan was taken, and how the laser moved meanwhile."""
        moved = self._sweep(scan)
        prepared = self._prepare(deskew(scan, extrinsics, moved, order), extrinsics)
        if self._last_ns is None:
            self._matched_ns = self._last_ns = scan.stamp_ns
        seconds = max(scan.stamp_ns - self._last_ns, 0) * 1e-9
        self._last_ns = scan.stamp_ns
        step = Pose2.Expmap(self._velocity * min(seconds, LONGEST_S))
        if prepared.valid < self._config.matcher.min_pairs or not self._kept:
            self._pose = self._pose * step
            if prepared.valid >= self._config.matcher.min_pairs:
                self._keep(Reference(self._pose, prepared), scan.stamp_ns)
            return self._placed(scan, moved)
        last = self._kept[-1].target_T_scan
        guess = last.between(self._pose * step)
        near = [Reference(last.between(at), kept) for at, kept in self._kept]
        evidence = self._expected(guess, last.between(self._pose), seconds)
        found = register(near, prepared, evidence, self._config.registration, self._config.matcher)
        if found.match_trusted:
            self._go_to(last * found.result.target_T_source, seconds)
            self._matched_ns = scan.stamp_ns
            self._keep_if_due(near, Reference(self._pose, prepared), found.result.target_T_source)
        else:
            self._pose = self._pose * step
            self._give_up_if_lost(Reference(self._pose, prepared), scan.stamp_ns)
        return self._placed(scan, self._sweep(scan))

    def _expected(self, guess: Pose2, before: Pose2, seconds: float) -> OdometryEvidence:
        """What is known of the step without the scan: the robot goes on, or it stands still."""
        free = min(seconds, LONGEST_S)
        along = LEAST_SIGMA_M + 0.5 * ACCELERATION * free**2
        turning = LEAST_SIGMA_RAD + 0.5 * TURN_ACCELERATION * free**2
        covariance = np.diag([along**2, along**2, turning**2])
        metres, radians = self._config.robot.reach(seconds + STAMP_JITTER_S)
        size = float(np.hypot(guess.x(), guess.y()))
        return OdometryEvidence(
            prior=Prior(guess, covariance),
            starts=[("zero motion", before)],
            possible=True,
            reach=(metres + size, min(radians + abs(guess.theta()), np.pi)),
            fault_rate=AFTER_FAULT,
            carried=NEVER,
        )

    def _go_to(self, pose: Pose2, seconds: float) -> None:
        step = Pose2.Logmap(self._pose.between(pose))
        self._pose = pose
        if seconds > 0.0:
            limits = self._config.robot
            self._velocity = np.asarray(step) / seconds
            speed = float(np.hypot(*self._velocity[:2]))
            if speed > limits.max_speed or abs(self._velocity[2]) > limits.max_turn_rate:
                self._velocity = np.zeros(3)

    def _keep_if_due(self, near: list[Reference], new: Reference, last_T_new: Pose2) -> None:
        seen = agreement(near, new.scan, last_T_new, self._config.matcher)
        known = seen.fitting / max(seen.fitting + seen.new + seen.contradicting, 1e-9)
        way, turn = float(np.hypot(last_T_new.x(), last_T_new.y())), abs(last_T_new.theta())
        if way > KEEP_AFTER_M or turn > KEEP_AFTER_RAD or known < KEEP_BELOW:
            self._kept.append(new)

    def _give_up_if_lost(self, new: Reference, stamp_ns: int) -> None:
        lost_s = (stamp_ns - self._matched_ns) * 1e-9
        if lost_s > LOST_S:
            self._broken_s += lost_s
            self._kept.clear()
            self._velocity = np.zeros(3)
            self._keep(new, stamp_ns)

    def _keep(self, new: Reference, stamp_ns: int) -> None:
        self._kept.append(new)
        self._matched_ns = stamp_ns

    def _sweep(self, scan: LaserScan) -> tuple[float, float, float]:
        """The motion from the first beam to the last."""
        moved = Pose2.Expmap(self._velocity * sweep_ns(scan) * 1e-9)
        return moved.x(), moved.y(), moved.theta()

    def _placed(self, scan: LaserScan, moved: tuple[float, float, float]) -> ScanWithOdometry:
        unknown_s = (scan.stamp_ns - self._matched_ns) * 1e-9
        return ScanWithOdometry(scan, self._pose, moved, False, unknown_s, self._broken_s)
