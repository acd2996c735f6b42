"""Wheels against scans: the scale of the wheels and where the laser sits, by hand-eye comparison.

A base that moves by b (complex, m) and turns by a, with a laser at p that looks along u, moves
the laser by l in the laser's own frame:  u l = b + (exp(ia) - 1) p.  Wheels that measure b / s
give  w l - (exp(ia) - 1) q = b / s  with w = u / s and q = p / s, which is linear in w and q
(the planar case of Censi, Franchi, Marchionni and Oriolo, T-RO 2013).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PRIOR_SIGMA_M = 0.3  # how far the laser may sit from where the log says
LEAST_TURN = 0.1  # rad by the scans; less says nothing of the scale of turns
LEAST_TURNS = 8  # so many such pairs
_NOISE_FLOOR = 0.001  # m or rad: no pair is better
_HUBER, _TUKEY = 1.345, 4.685  # sigmas; 95 % efficient for Gaussian noise
_ROUNDS = 15  # of each


@dataclass(frozen=True, slots=True)
class MotionFit:
    """What explains the wheels' steps best; sigmas are the fit's own."""

    distance_scale: float  # what the scans see over what the wheels count
    distance_sigma: float
    turn_scale: float  # likewise; nan where the robot hardly turned
    turn_sigma: float
    yaw: float  # rad, of the laser on the base
    yaw_sigma: float
    place: complex  # m, x + iy of the laser on the base
    place_sigma: float  # m, along the axis known worst


def fit_motion(
    wheels: Complex, wheel_turns: Array, laser: Complex, laser_turns: Array, extrinsics: complex
) -> MotionFit:
    """Fit scales and mount to the steps of n pairs, few of which may be wrong.

    Args:
        wheels: (n,) m, steps of the base by odometry, x + iy in the base frame at their start.
        wheel_turns: (n,) rad.
        laser: (n,) m, steps of the laser by matching, in the laser frame at their start.
        laser_turns: (n,) rad.
        extrinsics: m, x + iy of the laser as the log has it.
    """
    turned = np.exp(1j * laser_turns) - 1.0
    rows = np.concatenate([_rows(laser), _rows(-turned)], axis=2)
    found, covariance = _robust(rows, np.stack([wheels.real, wheels.imag], axis=1), extrinsics)
    w, q = complex(found[0], found[1]), complex(found[2], found[3])
    size = max(abs(w), 1e-9)
    sigma = math.sqrt(covariance[0, 0]) / size
    turn, turn_sigma = _turn_scale(wheel_turns, laser_turns)
    return MotionFit(
        distance_scale=1.0 / size,
        distance_sigma=sigma / size,
        turn_scale=turn,
        turn_sigma=turn_sigma,
        yaw=cmath.phase(w),
        yaw_sigma=sigma,
        place=q / size,
        place_sigma=math.sqrt(max(np.linalg.eigvalsh(covariance[2:, 2:]))) / size,
    )


def _rows(factors: Complex) -> Array:
    """(n, 2, 2): what a complex factor does to the real and imaginary part of an unknown."""
    re, im = factors.real, factors.imag
    return np.stack([np.stack([re, -im], axis=1), np.stack([im, re], axis=1)], axis=1)


def _turn_scale(wheel_turns: Array, laser_turns: Array) -> tuple[float, float]:
    """The scale and its sigma.  The scans count as true: their noise would bias it."""
    turns = np.abs(laser_turns) > LEAST_TURN
    if np.count_nonzero(turns) < LEAST_TURNS:
        return math.nan, math.nan
    found, covariance = _robust(laser_turns[turns, None, None], wheel_turns[turns, None])
    counted = math.copysign(max(abs(found[0]), 1e-3), found[0])  # rad by the wheels for a rad
    return 1.0 / counted, math.sqrt(covariance[0, 0]) / counted**2


def _robust(rows: Array, values: Array, extrinsics: complex | None = None) -> tuple[Array, Array]:
    """Solve rows @ x = values, (n, k, m) and (n, k), by reweighting; x and its covariance.

    Huber's weights first, which find the neighbourhood from anywhere, then Tukey's, which
    leave wrong pairs out.
    """
    found, covariance = _solved(rows, values, np.ones(len(rows)), _NOISE_FLOOR, extrinsics)
    for k in range(2 * _ROUNDS):
        errors = np.linalg.norm(values - rows @ found, axis=1)
        sigma = max(1.4826 * float(np.median(errors)), _NOISE_FLOOR)
        if k < _ROUNDS:
            weights = np.minimum(1.0, _HUBER * sigma / np.maximum(errors, sigma))
        else:
            weights = np.clip(1.0 - (errors / (_TUKEY * sigma)) ** 2, 0.0, 1.0) ** 2
        found, covariance = _solved(rows, values, weights, sigma, extrinsics)
    return found, covariance


def _solved(
    rows: Array, values: Array, weights: Array, sigma: float, extrinsics: complex | None
) -> tuple[Array, Array]:
    """One weighted solution; the place is held to `extrinsics` as far as turns do not tell."""
    normal = np.einsum("nkm,n,nkp->mp", rows, weights, rows)
    normal += 1e-12 * np.eye(len(normal))  # a robot that never moved
    right = np.einsum("nkm,n,nk->m", rows, weights, values)
    if extrinsics is not None:
        held = (sigma / PRIOR_SIGMA_M) ** 2
        normal[[2, 3], [2, 3]] += held
        right[2:] += held * np.array([extrinsics.real, extrinsics.imag])
    return np.linalg.solve(normal, right), sigma**2 * np.linalg.inv(normal)
