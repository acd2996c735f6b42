"""The drives of the paper's Section V, and what comes of matching chosen scans one to the next."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.drive import PAPER_LENGTHS_M, PAPER_SCANS, paper_drive
from slam.drivers.simulators.laser import LASERS, LaserConfig
from slam.drivers.simulators.paper_bed import BedConfig
from slam.frontend.information import CHAIN_CORRELATION, PredictionModel
from slam.frontend.keyframes import KeyframeConfig, interval_after, interval_ahead
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from slam.mapping.odometry import OdometryConfig

Reading = Literal["180cm", "878cm"]
Length = Callable[[PreparedScan], float]  # m from a scan to the next to be matched
Step = Callable[[int, int], Pose2]  # from scan i to scan j: i_T_j

READINGS: tuple[Reading, ...] = ("180cm", "878cm")
CONSTANT = (1, 5, 10, 15, 20)  # intervals in scans
INTERVALS = (*map(str, CONSTANT), "sdp-pe", "even", "sdp-pe-shipped", "even-shipped", "information")

# The paper's own figures for these intervals and, last, for SDP-PE.
PAPER_ERRORS_CM = (107.6, 30.6, 10.8, 8.3, 3.0, 2.4)
PAPER_SECONDS = (26.0, 3.7, 1.8, 1.0, 0.8, 0.7)
PAPER_COUNTS = (462, 93, 47, 31, 24, 23)  # scans

LASER = LASERS["hokuyo-181"]
EXTRINSICS = LaserExtrinsics(0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """One drive through one test bed."""

    scans: list[PreparedScan]
    odometry: list[Pose2]  # odom_T_base at each scan
    truth: list[Pose2]  # world_T_base likewise
    step_m: float  # from scan to scan
    period_s: float


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """What matching the chosen scans one to the next came to."""

    used: tuple[int, ...]  # indices of the chosen scans
    poses: NDArray[np.float64]  # (len(used), 3) world_T_base; the first is the truth
    error_m: float  # of the position of the last chosen scan
    matching_ms: float  # processor time of all matches together


def paper_bed_drive(
    reading: Reading, seed: int, bed: BedConfig | None = None, laser: LaserConfig = LASER
) -> Drive:
    """Simulate a drive; `seed` decides on the boards of the bed and on all noise."""
    scans, odometry, truth = [], [], []
    config = ScanConfig(range_noise=max(laser.sigma, 0.001))
    for message in paper_drive(reading, seed, seed, bed=bed, laser=laser):
        if isinstance(message, LaserScan):
            scans.append(prepare(message, EXTRINSICS, config))
        elif isinstance(message, WheelOdometry):
            odometry.append(Pose2(message.x, message.y, message.theta))
        elif isinstance(message, TruePose):
            truth.append(Pose2(message.x, message.y, message.theta))
    step_m = PAPER_LENGTHS_M[reading] / (PAPER_SCANS - 1)
    return Drive(scans, odometry, truth, step_m, 1.0 / laser.rate_hz)


def every(interval: int, scans: int = PAPER_SCANS) -> tuple[int, ...]:
    """Scans 0, k, 2k and so on, as the paper counts them: 462, 93, 47, 31 and 24 of 462."""
    return tuple(range(0, scans, interval))


def evenly(count: int, scans: int = PAPER_SCANS) -> tuple[int, ...]:
    """As many scans at equal distances from the first to the last."""
    return tuple(int(k) for k in np.linspace(0, scans - 1, count).round())


def chosen(drive: Drive, length: Length) -> tuple[int, ...]:
    """The scans that a method takes whose interval depends on what the last one sees.

    The last scan is always taken, lest a shorter way look better.
    """
    used = [0]
    while True:
        steps = int(np.ceil(length(drive.scans[used[-1]]) / drive.step_m))
        following = used[-1] + max(steps, 1)
        if following >= len(drive.scans) - 1:
            return (*used, len(drive.scans) - 1)
        used.append(following)


def sdp_pe(stretch: float = 1.0) -> Length:
    """SDP-PE's interval as it ships, times `stretch`.

    That sets how many scans are used, not where they lie closer than elsewhere.
    """
    config = KeyframeConfig(method="sdp-pe")
    return lambda scan: stretch * interval_after(scan, config).length


def information(drive: Drive, with_odometry: bool) -> Length:
    """The interval after which a match to this scan alone is predicted to be worth most."""
    config, matcher, wheels = KeyframeConfig(method="information"), MatchConfig(), OdometryConfig()
    speed = drive.step_m / drive.period_s

    def odometry(metres: float, radians: float) -> NDArray[np.float64]:
        if not with_odometry:
            return np.eye(3)
        return wheels.covariance(metres, radians, metres / speed)

    model = PredictionModel(
        odometry, 1, matcher.range_noise, CHAIN_CORRELATION, ScanConfig().gap_ratio,
        config.open.tolerance,
    )  # fmt: skip
    ahead = Pose2(1.0, 0.0, 0.0)
    return lambda scan: interval_ahead(scan, ahead, model, config).length


def matched(drive: Drive, config: MatchConfig, with_odometry: bool) -> Step:
    """Steps by one of our matchers; without odometry each match starts from no motion."""
    wheels = OdometryConfig()

    def step(i: int, j: int) -> Pose2:
        target, source = Reference(Pose2(), drive.scans[i]), drive.scans[j]
        if not with_odometry:
            return match([target], source, Pose2(), config).target_T_source
        moved = drive.odometry[i].between(drive.odometry[j])
        length = float(np.hypot(moved.x(), moved.y()))
        covariance = wheels.covariance(length, abs(moved.theta()), (j - i) * drive.period_s)
        return match([target], source, moved, config, Prior(moved, covariance)).target_T_source

    return step


def follow(drive: Drive, used: tuple[int, ...], step: Step) -> Outcome:
    """Chain the steps between the chosen scans, from the true first pose."""
    pose = drive.truth[used[0]]
    poses = [pose]
    begin = time.thread_time_ns()
    for i, j in pairwise(used):
        pose = pose * step(i, j)
        poses.append(pose)
    matching_ms = (time.thread_time_ns() - begin) * 1e-6
    off = drive.truth[used[-1]].between(pose)
    table = np.array([[p.x(), p.y(), p.theta()] for p in poses])
    return Outcome(used, table, float(np.hypot(off.x(), off.y())), matching_ms)
