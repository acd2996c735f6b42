"""Do wheels and scans agree?  Slip, scales, signs, and where the laser sits.

A bounded number of pairs of scans is matched without asking the wheels; pairs in which the
scans do not see the motion (corridors) have no say.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2

from slam.backend.chi_square import chi_square_limit
from slam.evaluation.calibration.closed_form import MotionFit, fit_motion
from slam.logs.findings import Finding, Severity
from slam.logs.messages import LaserExtrinsics, Message
from slam.mapping.odometry import OdometryConfig
from slam.tools.doctor.motion_match import NO_MOUNT, Judged, PairMatcher
from slam.tools.doctor.motion_pairs import BLOCK, Pair, PairCollector

LEAST_PAIRS = 12  # that can be judged, for anything to be said of the whole log
SURE = 5.0  # sigmas
SCALE, SCALE_ERROR = 0.10, 0.30  # the pipeline trusts the wheels to 5 % a metre
TURN, TURN_ERROR = 0.20, 0.50  # and to 10 % a turn
YAW, YAW_ERROR = math.radians(2.0), math.radians(20.0)  # 2 degrees bend 10 m by 35 cm
PLACE_M = 0.10
FALSE_ALARM = 1e-6  # how often an honest pair may be called a slip
MANY = 0.3  # of the pairs: then it is not an accident
LEAST_SWING = 0.3  # rad/s: then a late stamp shows above the noise of the match
LEAST_SWINGS = 6  # so many such pairs
_MOST, _MOST_SIGMAS = 0.8, 1.28  # so many of all errors are below so many sigmas
_MEDIAN = 2.366  # of a chi-square variable of three degrees of freedom
_MATCH_VARIANCE = np.diag([0.01, 0.01, 0.005]) ** 2  # m, m, rad: also of stamps and moving things


@dataclass(frozen=True, eq=False, slots=True)
class _Dispute:
    """Pairs, one or some in a row, over which wheels and scans disagree."""

    pairs: Sequence[Pair]
    wheels: Pose2  # as they count
    scans: Pose2
    excess: float  # chi-square over what honest wheels may have


class MotionCheck:
    """Scans and odometry in file order; `findings` matches and compares."""

    def __init__(self) -> None:
        self._collector = PairCollector()

    def feed(self, message: Message) -> None:
        """Take in one message."""
        self._collector.feed(message)

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        extrinsics = self._collector.extrinsics or NO_MOUNT
        place = complex(extrinsics.x, extrinsics.y)
        matcher = PairMatcher(Pose2(extrinsics.x, extrinsics.y, extrinsics.theta))
        judged = [j for p in self._collector.moving.pairs() if (j := matcher.judge(p))]
        if len(judged) < LEAST_PAIRS:
            return
        fit = fit_motion(*_steps(judged), place)
        yield from _systematic(fit, extrinsics)
        still = [j for p in self._collector.still.pairs() if (j := matcher.judge(p))]
        late_s = _late_s(judged, fit)
        spread = _spread(judged, fit, late_s)
        disputes = _disputes(judged, fit, spread, late_s) + _disputes(still, fit, spread, late_s)
        yield from _disputed(disputes, judged + still)


def _steps(judged: Sequence[Judged]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    steps = [(j.pair.step, j.laser) for j in judged]
    wheels, laser = (
        np.array([complex(pose[k].x(), pose[k].y()) for pose in steps]) for k in (0, 1)
    )
    turns = np.array([[a.theta(), b.theta()] for a, b in steps])
    return wheels, turns[:, 0], laser, turns[:, 1]


def _systematic(fit: MotionFit, extrinsics: LaserExtrinsics) -> Iterator[Finding]:
    """What is wrong all the time."""
    turn, turn_off = fit.turn_scale, abs(fit.turn_scale - 1.0)
    if turn < 0.0 and -turn > SURE * fit.turn_sigma:
        yield Finding(
            "error", "odometry-turn-sign", "/odom",
            "the wheels turn one way and the scans the other: the laser hangs upside down, or the "
            "odometry's heading has the wrong sign",
        )  # fmt: skip
        return
    if turn_off > TURN and turn_off > SURE * fit.turn_sigma:
        yield Finding(
            _severity(turn_off, TURN_ERROR), "odometry-turn-scale", "/odom",
            f"the scans turn {turn:.2f} times as far as the wheels say: calibrate the wheel base",
        )  # fmt: skip
    scale, scale_off = fit.distance_scale, abs(fit.distance_scale - 1.0)
    if scale_off > SCALE and scale_off > SURE * fit.distance_sigma:
        yield Finding(
            _severity(scale_off, SCALE_ERROR), "odometry-scale", "/odom",
            f"the scans move {scale:.2f} times as far as the wheels say: wrong units or conversion "
            "factors, or another wheel size",
        )  # fmt: skip
    off = math.remainder(fit.yaw - extrinsics.theta, math.tau)
    if abs(off) > YAW and abs(off) > SURE * fit.yaw_sigma:
        back = ", or the odometry has the wrong sign" if abs(off) > 0.9 * math.pi else ""
        yield Finding(
            _severity(abs(off), YAW_ERROR), "mount-yaw", "/tf",
            f"the laser looks {math.degrees(fit.yaw):.1f} +- {math.degrees(fit.yaw_sigma):.1f} deg "
            f"off the robot's front, not {math.degrees(extrinsics.theta):.1f} deg "
            f"as the log says{back}",
        )  # fmt: skip
    elsewhere = abs(fit.place - complex(extrinsics.x, extrinsics.y))
    if elsewhere > PLACE_M and elsewhere > SURE * fit.place_sigma:
        yield Finding(
            "warning", "mount-place", "/tf",
            f"turns say that the laser sits at ({fit.place.real:.2f}, {fit.place.imag:.2f}) +- "
            f"{fit.place_sigma:.2f} m, not at ({extrinsics.x:.2f}, {extrinsics.y:.2f}) m as the "
            "log says",
        )  # fmt: skip


def _severity(off: float, error: float) -> Severity:
    return "error" if off > error else "warning"


def _disputes(
    judged: Sequence[Judged], fit: MotionFit, spread: float, late_s: float
) -> list[_Dispute]:
    """Single pairs and blocks of neighbours that sound wheels could not give."""
    groups = [*([j] for j in judged), *_rows_of(judged)]
    compared = (_compared(group, fit, spread, late_s) for group in groups)
    return [dispute for dispute in compared if dispute.excess > 1.0]


def _late_s(judged: Sequence[Judged], fit: MotionFit) -> float:
    """How far the times of wheels and scans are apart by turns, one sigma, s; 0 unless it shows.

    Only a robot that turns differently at both ends of a pair shows it: stamps that are late
    move a part of the turn into the next pair.
    """
    scale = fit.turn_scale if math.isfinite(fit.turn_scale) else 1.0
    late = [
        abs(scale * one.pair.step.theta() - one.laser.theta()) / swing
        for one in judged
        if (swing := abs(one.pair.speed_after[1] - one.pair.speed[1])) > LEAST_SWING
    ]
    if len(late) < LEAST_SWINGS:
        return 0.0
    late_s = float(np.quantile(late, _MOST)) / _MOST_SIGMAS
    return late_s if late_s > OdometryConfig().sync else 0.0  # which is allowed for anyway


def _spread(judged: Sequence[Judged], fit: MotionFit, late_s: float) -> float:
    """By how much the log's own pairs scatter more than honest ones would; 1 at least.

    Stamps that are late by turns and motion within a sweep let every step differ: an accident
    has to stand out from what is ordinary in its log.
    """
    limit = chi_square_limit(FALSE_ALARM, 3)
    usual = np.median([_compared([one], fit, 1.0, late_s).excess for one in judged])
    return max(1.0, float(usual) * limit / _MEDIAN)


def _compared(group: Sequence[Judged], fit: MotionFit, spread: float, late_s: float) -> _Dispute:
    """Neighbours as wheels and scans have them, with what is systematic taken out."""
    extrinsics = Pose2(fit.place.real, fit.place.imag, fit.yaw)
    known = math.isfinite(fit.turn_scale)
    turn_scale, turn_sigma = (fit.turn_scale, fit.turn_sigma) if known else (1.0, 0.0)
    wheels, corrected, scans = Pose2(), Pose2(), Pose2()
    distance_m = turn_rad = 0.0  # by the scans: faulty wheels must not widen their own limits
    for one in group:
        step, scale = one.pair.step, fit.distance_scale
        wheels *= step
        corrected *= Pose2(scale * step.x(), scale * step.y(), turn_scale * step.theta())
        seen = extrinsics * one.laser * extrinsics.inverse()
        scans *= seen
        distance_m += math.hypot(seen.x(), seen.y())
        turn_rad += abs(seen.theta())
    pairs = [one.pair for one in group]
    seconds = sum(pair.seconds for pair in pairs)
    honest = OdometryConfig().covariance(distance_m, turn_rad, seconds)
    unsure = (
        fit.distance_sigma * distance_m, fit.yaw_sigma * distance_m + fit.place_sigma * turn_rad,
        turn_sigma * turn_rad,
    )  # fmt: skip
    faster, turning = (
        late_s * abs(b - a) for a, b in zip(pairs[0].speed, pairs[-1].speed_after, strict=True)
    )
    honest += np.diag(unsure) ** 2 + len(group) * _MATCH_VARIANCE
    honest += np.diag([faster, faster, turning]) ** 2
    error = Pose2.Logmap(corrected.between(scans))
    distance = float(error @ np.linalg.solve(honest, error))
    return _Dispute(pairs, wheels, scans, distance / spread / chi_square_limit(FALSE_ALARM, 3))


def _rows_of(judged: Sequence[Judged]) -> Iterator[Sequence[Judged]]:
    """Blocks of neighbours without a gap."""
    for k in range(len(judged) - BLOCK + 1):
        group = judged[k : k + BLOCK]
        if group[-1].pair.serial - group[0].pair.serial == BLOCK - 1:
            yield group


def _disputed(disputes: Sequence[_Dispute], judged: Sequence[Judged]) -> Iterator[Finding]:
    if not disputes:
        return
    lone = len(disputes) == 1  # which may as well be the fault of a single match
    single = [dispute for dispute in disputes if len(dispute.pairs) == 1]
    disputes = single or disputes  # a block tells less exactly when it was
    worst = max(disputes, key=lambda dispute: dispute.excess)
    count = len({id(pair) for dispute in disputes for pair in dispute.pairs})
    first = min(dispute.pairs[0].first.stamp_ns for dispute in disputes)
    told = (
        f"over {count} of {len(judged)} steps looked at, most where the wheels say "
        f"{_words(worst.wheels)} and the scans {_words(worst.scans)}"
    )
    if not lone and 2 * sum(map(_opposite, single)) > len(single):
        yield Finding(
            "error", "odometry-sign", "/odom",
            f"the wheels count the other way than the robot goes, {told}", count, first,
        )  # fmt: skip
        return
    severity: Severity = "error" if count > MANY * len(judged) else "warning"
    yield Finding(
        "note" if lone else severity, "wheel-slip", "/odom",
        f"wheels and scans disagree (slip, a push, or an encoder that fails) {told}",
        count, first,
    )  # fmt: skip


def _opposite(dispute: _Dispute) -> bool:
    wheels, scans = (complex(p.x(), p.y()) for p in (dispute.wheels, dispute.scans))
    along = (wheels * scans.conjugate()).real
    return min(abs(wheels), abs(scans)) > 0.1 and along < -0.5 * abs(wheels) * abs(scans)


def _words(step: Pose2) -> str:
    return f"{math.hypot(step.x(), step.y()):.2f} m and {math.degrees(step.theta()):.0f} deg"
