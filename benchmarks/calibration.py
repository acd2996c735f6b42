"""`slam bench calibration`: simulated robots of known sizes, calibrated from a drive each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.drive import BASE_T_LASER, simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.miscalibration import Miscalibration
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import Scenario, scenario
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig
from slam.logs.messages import SensorMessage

from benchmarks.spread import spread
from slam.evaluation.calibration.result import calibrate_sources

QUICK_SEEDS = 5
LASER_POSE = (0.16, 0.03, math.radians(2.0))
DELAY_S = 0.04
WORLD = "calibration-room"
SIGMAS = 3.0  # within which a value counts as recovered
# Random errors as usual; what is systematic is that of the case alone.
NOISE = replace(ODOMETRY_NOISE["typical"], distance_scale=0.0, turn_scale=0.0, drift=0.0)


@dataclass(frozen=True, slots=True)
class Case:
    """A robot to be calibrated, and its drive."""

    name: str
    left_scale: float
    right_scale: float
    track_scale: float
    laser: str = "hokuyo-181"
    straight: bool = False
    seeds: int = 100

    @property
    def wrong(self) -> Miscalibration:
        """What its log takes for true."""
        return Miscalibration(
            left_scale=self.left_scale, right_scale=self.right_scale,
            track_scale=self.track_scale, odometry_delay_s=DELAY_S,
            stated=(BASE_T_LASER.x(), BASE_T_LASER.y(), 0.0),
        )  # fmt: skip

    def truth(self) -> dict[str, float]:
        """What there is to be found, by name."""
        wrong = self.wrong
        wheels = wrong.true_from_counted
        return {
            "laser_x": LASER_POSE[0], "laser_y": LASER_POSE[1],
            "laser_yaw_deg": math.degrees(LASER_POSE[2]),
            "translation_scale": wheels[0, 0], "rotation_scale": wheels[1, 1],
            "curvature": wheels[1, 0], "time_offset_s": -DELAY_S,
            "left_wheel_scale": self.left_scale, "right_wheel_scale": self.right_scale,
            "track_m": self.track_scale * wrong.track_m,
        }  # fmt: skip


CASES = (
    Case("both wheels 3 %, track 2 %", 1.03, 1.03, 1.02),
    Case("left 3 %, track 2 %", 1.03, 1.0, 1.02),
    Case("the same, RPLidar A1", 1.03, 1.0, 1.02, "rplidar-a1", seeds=30),
    Case("straight drive", 1.03, 1.03, 1.02, straight=True, seeds=30),
)


@dataclass(frozen=True, slots=True)
class _Job:
    case: Case
    seed: int


def bench_calibration(quick: bool, echo: Callable[[str], None], workers: int = 0) -> dict[str, Any]:
    """Calibrate each case with many seeds: errors, sigmas, and how often they hold."""
    rows: list[dict[str, Any]] = []
    for case in CASES:
        seeds = QUICK_SEEDS if quick else case.seeds
        jobs = [_Job(case, seed) for seed in range(seeds)]
        runs = spread(calibrated, jobs, workers)
        rows += rows_of(case, runs)
        echo(f"{case.name}: {seeds} drives")
    return {"meta": {"world": WORLD, "laser_pose": LASER_POSE}, "rows": rows}


def calibrated(job: _Job) -> dict[str, tuple[float, float, bool]]:
    """Value, sigma and whether it was refused, by name, of one drive."""
    source = partial(drive, job.case, job.seed)
    track_m = job.case.wrong.track_m
    found = calibrate_sources([source], MatchConfig(), ScanConfig(), track_m)
    return {
        one.name: (one.value, one.sigma, bool(one.refused)) for one in (*found.found, *found.wheels)
    }


def drive(case: Case, seed: int) -> Iterable[SensorMessage]:
    """The log of a case."""
    place = scenario(WORLD, seed)
    if case.straight:
        place = Scenario("straight", place.world, (Leg(((-2.6, 0.0), (2.6, 0.0))),))
    drive = simulate(
        place, LASERS[case.laser], NOISE, seed, base_T_laser=Pose2(*LASER_POSE),
        passes=12 if case.straight else 1,
    )  # fmt: skip
    return case.wrong.apply(drive)


def rows_of(
    case: Case, runs: Sequence[dict[str, tuple[float, float, bool]]]
) -> list[dict[str, Any]]:
    """A row for each unknown: errors and sigmas where it was found, and how often that was."""
    return [_row(case, name, true, runs) for name, true in case.truth().items()]


def _row(
    case: Case, name: str, true: float, runs: Sequence[dict[str, tuple[float, float, bool]]]
) -> dict[str, Any]:
    found: NDArray[np.float64] = np.array([run[name] for run in runs])
    given = found[found[:, 2] == 0.0]
    errors = given[:, 0] - true
    row = {"case": case.name, "unknown": name, "truth": true, "drives": len(runs)}
    row["refused"] = int(len(found) - len(given))
    if not len(given):
        return row | dict.fromkeys(("rms_error", "sigma", "sigma_max", "within"))
    return row | {
        "rms_error": float(np.sqrt(np.mean(errors**2))),
        "sigma": float(np.median(given[:, 1])),
        "sigma_max": float(given[:, 1].max()),
        "within": float(np.mean(np.abs(errors) <= SIGMAS * given[:, 1])),
    }
