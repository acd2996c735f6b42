"""What follows from a calibration: single wheels and the track, and the odometry's noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.calibration.fit import Fit
from slam.evaluation.calibration.model import CURVATURE, ROTATION, TRANSLATION
from slam.evaluation.calibration.noise import GAUSSIAN
from slam.evaluation.calibration.unknowns import TURNING, Found

Array = NDArray[np.float64]

_WHEELS_REFUSED = "shows where a drive has both ways and turns"


def wheel_sizes(values: Array, covariance: Array, track_m: float) -> tuple[Found, ...]:
    """Sizes of both wheels over those taken, and the track width."""

    def sizes(of: Array) -> Array:
        track = track_m * of[TRANSLATION] / of[ROTATION]
        apart = 0.5 * of[CURVATURE] * track
        return np.array([of[TRANSLATION] - apart, of[TRANSLATION] + apart, track])

    step = 1e-6
    slopes = np.stack(
        [(sizes(values + step * one) - sizes(values - step * one)) / (2 * step)
         for one in np.eye(len(values))], axis=1,
    )  # fmt: skip
    sigmas = np.sqrt(np.diag(slopes @ covariance @ slopes.T))
    names = (("left_wheel_scale", "", 1.0), ("right_wheel_scale", "", 1.0),
             ("track_m", "m", track_m))  # fmt: skip
    return tuple(
        Found(
            name, unit, float(value), float(sigma), stated,
            _WHEELS_REFUSED if sigma > 0.01 * stated else "", TURNING,
        )
        for (name, unit, stated), value, sigma in zip(names, sizes(values), sigmas, strict=True)
    )  # fmt: skip


def random_errors(fit: Fit) -> tuple[Found, ...]:
    """Random errors of the odometry as standard deviations of Gaussian noise."""
    names = (
        ("along", 0, 1, "m/sqrt(m)"), ("along_turning", 0, 2, "m/sqrt(rad)"),
        ("across", 1, 1, "m/sqrt(m)"), ("heading_turning", 2, 2, "rad/sqrt(rad)"),
        ("heading_driving", 2, 1, "rad/sqrt(m)"),
    )  # fmt: skip
    found = []
    for name, row, column, unit in names:
        variance = fit.noise.components[row, column] / GAUSSIAN
        spread = fit.noise.sigmas[row, column] / GAUSSIAN
        value = math.sqrt(variance)
        sigma = spread / (2.0 * value) if variance > spread else math.sqrt(spread)
        found.append(Found(name, unit, value, sigma, None))
    return tuple(found)
