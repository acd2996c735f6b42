"""Simulated drives: the messages of a robot on its way through a scenario, with the truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.faults import OdometryFault, corrupted, has_scan
from slam.drivers.simulators.laser import LASERS, LaserConfig, take_moving_scan, take_scan
from slam.drivers.simulators.paper_bed import BedConfig, paper_bed
from slam.drivers.simulators.path import MotionConfig
from slam.drivers.simulators.robot import (
    ODOMETRY_NOISE,
    OdometryNoise,
    Track,
    drive,
    quantised,
    to_and_fro,
    track_of,
    wheel_increments,
)
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import Scenario
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, TruePose, WheelOdometry

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

EPOCH_NS = 1_700_000_000_000_000_000  # first stamp of every drive: fixed, so that logs repeat
BASE_T_LASER = Pose2(0.16, 0.0, 0.0)  # on the P3-DX's deck, ahead of the wheel axis
ODOMETRY_RATE_HZ = 10.0  # a standard packet every 100 ms (ARCOS default)
PAPER_SCANS = 462  # section V of the seed paper
PAPER_LENGTHS_M = {"180cm": 1.80, "878cm": 8.78}  # end point as stated, and 462 x 1.9 cm

# Each source of chance has its own stream, so that a change to one leaves the others alone.
# The scenario's geometry uses the stream of its bare seed.
_WHEELS, _LASER = 1, 2


def simulate(
    scenario: Scenario,
    laser: LaserConfig = LASERS["hokuyo-181"],
    noise: OdometryNoise = ODOMETRY_NOISE["typical"],
    seed: int = 0,
    *,
    faults: Sequence[OdometryFault] = (),
    base_T_laser: Pose2 = BASE_T_LASER,
    odometry_rate_hz: float = ODOMETRY_RATE_HZ,
    odometry_at_scans: bool = True,
    motion: MotionConfig | None = None,
    passes: int = 1,
) -> Iterator[SensorMessage]:
    """Yield what the robot's sensors say while it drives `scenario`, in stamp order.

    With more than one of the `passes` it comes back in reverse, goes there again, and so on.

    The mount comes first.  At one stamp odometry precedes the true pose, and that the scan;
    every scan has a true pose, and with `odometry_at_scans` also an odometry of its own
    stamp.  The odom frame starts at the first pose.  Equal arguments give equal bits.

    Raises:
        ValueError: if the robot cannot follow the path, or there is no pass.
    """
    truth = to_and_fro(drive(scenario.path, motion), passes)
    odometry = dead_reckoning(truth, noise, seed, faults)
    scan_times = np.arange(0.0, truth.duration_s, 1.0 / laser.rate_hz)
    scan_times = scan_times[has_scan(scan_times, faults)]
    odometry_times = np.arange(0.0, truth.duration_s, 1.0 / odometry_rate_hz)
    if odometry_at_scans:
        odometry_times = np.concatenate([odometry_times, scan_times])
    wheels = _odometry(odometry, np.unique(_stamps(odometry_times)), noise)
    scans = _scans(scenario.world, truth, base_T_laser, laser, scan_times, seed)
    yield LaserExtrinsics(EPOCH_NS, base_T_laser.x(), base_T_laser.y(), base_T_laser.theta())
    yield from _interleaved(wheels, scans)


def paper_drive(
    reading: Literal["180cm", "878cm"],
    seed: int = 0,
    geometry_seed: int = 0,
    *,
    bed: BedConfig | None = None,
    laser: LaserConfig = LASERS["hokuyo-181"],
    noise: OdometryNoise = ODOMETRY_NOISE["optimistic"],
) -> Iterator[SensorMessage]:
    """Yield the drive of the paper's section V: 462 scans, equally spaced on a straight line.

    The first scan is at the start and the last at the end point, so that a step is 0.39 or
    1.9 cm.  The laser sits at the centre of the base, whose pose the paper reports; the
    order of the messages is that of `simulate`.
    """
    length = PAPER_LENGTHS_M[reading]
    world = paper_bed(length, bed or BedConfig(), np.random.default_rng(geometry_seed))
    steps = np.zeros((PAPER_SCANS - 1, 3))
    steps[:, 0] = length / (PAPER_SCANS - 1)
    truth = track_of((0.0, 0.0, 0.0), steps, 1.0 / laser.rate_hz)
    times = np.arange(PAPER_SCANS) / laser.rate_hz
    wheels = _odometry(dead_reckoning(truth, noise, seed), _stamps(times), noise)
    yield LaserExtrinsics(EPOCH_NS, 0.0, 0.0, 0.0)
    yield from _interleaved(wheels, _scans(world, truth, Pose2(), laser, times, seed))


def dead_reckoning(
    truth: Track, noise: OdometryNoise, seed: int, faults: Sequence[OdometryFault] = ()
) -> Track:
    """Return `odom_T_base` as the wheels of a robot on `truth` have it; it starts at zero."""
    measured = wheel_increments(truth, noise, np.random.default_rng([seed, _WHEELS]))
    return track_of((0.0, 0.0, 0.0), corrupted(measured, truth, faults), truth.step_s)


def _stamps(times_s: Array) -> Stamps:
    return EPOCH_NS + np.round(times_s * 1e9).astype(np.int64)


def _seconds(stamps: Stamps) -> Array:
    return (stamps - EPOCH_NS).astype(np.float64) * 1e-9


def _odometry(odometry: Track, stamps: Stamps, noise: OdometryNoise) -> Iterator[WheelOdometry]:
    poses = quantised(odometry.at(_seconds(stamps)), noise)
    for stamp_ns, (x, y, theta) in zip(stamps.tolist(), poses.tolist(), strict=True):
        yield WheelOdometry(stamp_ns, x, y, theta)


def _scans(
    world: World, truth: Track, base_T_laser: Pose2, laser: LaserConfig, times_s: Array, seed: int
) -> Iterator[tuple[TruePose, LaserScan]]:
    rng = np.random.default_rng([seed, _LASER])
    stamps = _stamps(times_s)
    for stamp_ns, pose in zip(stamps.tolist(), truth.at(_seconds(stamps)).tolist(), strict=True):
        now = laser.sweep(rng)
        if now.beam_period_s > 0.0:
            beam_times = np.arange(now.beams) * now.beam_period_s
            bases = truth.at((stamp_ns - EPOCH_NS) * 1e-9 + beam_times)
            scan = take_moving_scan(world, _mounted(bases, base_T_laser), now, rng, stamp_ns)
        else:
            scan = take_scan(world, Pose2(*pose) * base_T_laser, now, rng, stamp_ns)
        yield TruePose(stamp_ns, *pose), scan


def _mounted(world_T_bases: Array, base_T_laser: Pose2) -> Array:
    """Return the laser's poses on a robot at the (n, 3) poses."""
    x, y, theta = world_T_bases.T
    ahead, left = base_T_laser.x(), base_T_laser.y()
    return np.column_stack(
        [
            x + ahead * np.cos(theta) - left * np.sin(theta),
            y + ahead * np.sin(theta) + left * np.cos(theta),
            theta + base_T_laser.theta(),
        ]
    )


def _interleaved(
    wheels: Iterator[WheelOdometry], scans: Iterator[tuple[TruePose, LaserScan]]
) -> Iterator[SensorMessage]:
    """Merge both by stamp, odometry first where they coincide."""
    waiting = next(wheels, None)
    for true_pose, scan in scans:
        while waiting is not None and waiting.stamp_ns <= scan.stamp_ns:
            yield waiting
            waiting = next(wheels, None)
        yield true_pose
        yield scan
    if waiting is not None:
        yield waiting
    yield from wheels
