"""Whether the matcher's covariance is consistent: simulated matches against their errors.

The settings of the covariance were calibrated on worlds of the seeds from CALIBRATION on; what
is reported comes from other worlds and other noise, of the seeds from EVALUATION on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from scipy.stats import chi2
from slam.drivers.simulators.laser import take_scan
from slam.drivers.simulators.robot import drive
from slam.drivers.simulators.worlds import scenario
from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare

from benchmarks.matcher.pairs import CENTRED, laser_of

Array = NDArray[np.float64]

WORLDS = ("corridor", "plain-corridor", "office", "clutter")
CALIBRATION, EVALUATION = 100, 5000  # first seeds
PRIOR_SIGMAS = np.array([0.03, 0.03, 0.02])  # m, m, rad: by how much the odometry errs
PLACES = 60  # a world: then comes the world of the next seed
CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """A scan to match, and odometry whose errors match its covariance."""

    target: PreparedScan
    source: PreparedScan
    target_T_source: Pose2
    prior: Prior


def cases(name: str, count: int, first_seed: int, beams: int = 181) -> Iterator[Case]:
    """Steps of 0.1 to 0.5 m and up to 15 degrees along the way through worlds of a kind."""
    rng = np.random.default_rng((first_seed, 17))
    laser, config, made, seed = laser_of(beams), ScanConfig(), 0, first_seed
    while True:
        place = scenario(name, seed)
        track, seed = drive(place.path), seed + 1
        for share in rng.uniform(0.05, 0.95, PLACES):
            pose = Pose2(*track.at(np.array([share * track.duration_s]))[0])
            step = Pose2(rng.uniform(0.1, 0.5), rng.uniform(-0.05, 0.05), rng.uniform(-0.26, 0.26))
            there = pose * step
            if place.world.clearance(np.array([[there.x(), there.y()]]))[0] < 0.2:
                continue
            if made == count:
                return
            made += 1
            error = rng.normal(size=3) * PRIOR_SIGMAS
            target = prepare(take_scan(place.world, pose, laser, rng), CENTRED, config)
            source = prepare(take_scan(place.world, there, laser, rng), CENTRED, config)
            prior = Prior(step * Pose2.Expmap(error), np.diag(PRIOR_SIGMAS**2))
            yield Case(target, source, step, prior)


def matched(case: Case, config: MatchConfig) -> tuple[MatchResult, Array]:
    """The match, and its error (x, y, theta) in the source frame."""
    reference = [Reference(Pose2(), case.target)]
    result = match(reference, case.source, case.prior.target_T_source, config, case.prior)
    error = Pose2.Logmap(result.target_T_source.between(case.target_T_source))
    return result, np.asarray(error)


def consistency(
    world: str, count: int, first_seed: int = EVALUATION, config: MatchConfig | None = None
) -> dict[str, Any]:
    """ANEES of each axis with its band, the ratio of sigmas, and the share inside 3 sigma."""
    config = config or MatchConfig()
    squares, ratios, errors, sigmas, refused = [], [], [], [], 0
    for case in cases(world, count, first_seed):
        result, error = matched(case, config)
        if not result.converged:
            refused += 1
            continue
        squares.append(error**2 / np.diag(result.covariance))
        low, high = np.linalg.eigvalsh(result.covariance[:2, :2])
        ratios.append(np.sqrt(high / low))
        errors.append(error)
        sigmas.append(result.sigmas)
    n = len(squares)
    tail = 0.5 * (1.0 - CONFIDENCE)
    band = [float(chi2.ppf(p, n) / n) for p in (tail, 1.0 - tail)]
    anees = np.mean(squares, axis=0)
    return {
        "world": world,
        "matches": n,
        "refused": refused,
        "anees": anees.tolist(),
        "band": band,
        "within_band": [bool(band[0] <= value <= band[1]) for value in anees],
        "sigma_ratio_median": float(np.median(ratios)),
        "sigma_ratio_share_over_20": float(np.mean(np.array(ratios) >= 20.0)),
        "inside_3_sigma": np.mean(np.array(squares) < 9.0, axis=0).tolist(),
        "rms_error": np.sqrt(np.mean(np.square(errors), axis=0)).tolist(),
        "sigma_median": np.median(sigmas, axis=0).tolist(),
        "first_seed": first_seed,
        "calibration_first_seed": CALIBRATION,
    }
