"""Finds out in which order the beams of a scan were measured, by the turns of the robot.

Drivers state a time from beam to beam, and not all state the truth: some stamp a sweep at its end,
and lasers that turn clockwise have their readings sorted.  A scan taken in a turn is bent; straight
again it fits a scan taken at rest.  Of the orders there are, the one that fits best is right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.frontend.deskew import SWEEP_ORDERS, SweepOrder, deskew
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan
from slam.logs.messages import LaserExtrinsics, LaserScan
from slam.mapping.keyframe import Preparer

# rad in one sweep: what is called at rest bends a scan by less than its beams are apart, what is
# called a turn by more than a match can overlook.
AT_REST_RAD, TURNING_RAD = 0.01, 0.05
LONGEST_WAY_M, LONGEST_TURN_RAD = 0.5, 0.8  # between the two scans
# Two scans give one vote: the share of beams that fit in each order.  Neighbouring votes are of
# one turn; after several turns the best must lead by as much as clutter differs.
LEAST_VOTES, LEAD = 8, 0.02
OPEN = np.diag([0.05, 0.05, 0.1]) ** 2  # m^2, rad^2, of the odometry between the two scans


@dataclass(frozen=True, eq=False, slots=True)
class _AtRest:
    odom_T_base: Pose2
    scan: PreparedScan


class SweepTiming:
    """Votes on the order with every scan of a turn; begins with what drivers are asked to do."""

    def __init__(self, config: MatchConfig, prepare: Preparer) -> None:
        self._config, self._prepare = config, prepare
        self.order: SweepOrder = SWEEP_ORDERS[0]
        self._rest: _AtRest | None = None
        self._fits: NDArray[np.float64] = np.zeros(len(SWEEP_ORDERS))
        self._votes = 0

    def watch(
        self, scan: LaserScan, extrinsics: LaserExtrinsics, odom_T_base: Pose2,
        moved: tuple[float, float, float],
    ) -> None:  # fmt: skip
        """Look at a scan as it was measured, and the motion of a sweep, as `deskew` takes it."""
        if not scan.beam_period_s:
            return
        turn = abs(moved[2])
        if turn < AT_REST_RAD:
            self._rest = _AtRest(odom_T_base, self._prepare(scan, extrinsics))
        elif turn > TURNING_RAD and self._rest is not None:
            self._vote(self._rest, scan, extrinsics, odom_T_base, moved)

    def _vote(
        self, rest: _AtRest, scan: LaserScan, extrinsics: LaserExtrinsics, odom_T_base: Pose2,
        moved: tuple[float, float, float],
    ) -> None:  # fmt: skip
        step = rest.odom_T_base.between(odom_T_base)
        if np.hypot(step.x(), step.y()) > LONGEST_WAY_M or abs(step.theta()) > LONGEST_TURN_RAD:
            return
        fits = []
        for order in SWEEP_ORDERS:
            straight = self._prepare(deskew(scan, extrinsics, moved, order), extrinsics)
            known = Prior(step, OPEN)
            found = match([Reference(Pose2(), rest.scan)], straight, step, self._config, known)
            fits.append(found.inlier_fraction if found.converged else 0.0)
        self._fits += fits
        self._votes += 1
        best = int(np.argmax(self._fits))
        lead = self._fits[best] - self._fits[SWEEP_ORDERS.index(self.order)]
        if self._votes >= LEAST_VOTES and lead > LEAD * self._votes:
            self.order = SWEEP_ORDERS[best]
