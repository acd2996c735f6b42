"""Numba kernels that turn the sums of a match into information, covariance and weak axis."""

from __future__ import annotations

import numpy as np
from numba import njit

from frontend.icp_kernels import FEIGNED


@njit(cache=True, nogil=True)
def invert3(a, out):
    """Inverse of a (3, 3) matrix by its adjugate."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    scale = 1.0 / (a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02)
    out[0, 0] = c00 * scale
    out[1, 0] = c01 * scale
    out[2, 0] = c02 * scale
    out[0, 1] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) * scale
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * scale
    out[2, 1] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) * scale
    out[0, 2] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) * scale
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * scale
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * scale


@njit(cache=True, nogil=True)
def eigen2(a, b, c):
    """Smaller and larger eigenvalue of [[a, b], [b, c]] and the direction (rad) of the smaller."""
    half = 0.5 * (a + c)
    root = np.sqrt(0.25 * (a - c) * (a - c) + b * b)
    # The larger eigenvalue's direction is half the angle of (a - c, 2 b).
    return half - root, half + root, 0.5 * np.arctan2(2.0 * b, a - c) + 0.5 * np.pi


@njit(cache=True, nogil=True)
def own_information(system, spread, floor_trans, floor_rot, information):
    """(3, 3) information of the match alone, with what noisy normals feign taken out.

    Normals that err by a variance s2 turn the information n n' into n n' + s2 t t': a plain
    wall seems to know where along it the robot is.  The expected surplus is subtracted, as far
    as the difference keeps no negative direction; then the bias floor is added to the
    covariance, in information form, since axes may be blind.  `spread` (m^2) is the variance
    that one residual counts with.
    """
    f = FEIGNED
    low, high, angle = eigen2(
        system[0] - system[f], system[1] - system[f + 1], system[3] - system[f + 2]
    )
    low, high = max(low, 0.0), max(high, 0.0)
    c, s = np.cos(angle), np.sin(angle)
    h = np.empty((3, 3))
    h[0, 0] = low * c * c + high * s * s
    h[0, 1] = (low - high) * c * s
    h[1, 1] = low * s * s + high * c * c
    h[0, 2], h[1, 2], h[2, 2] = system[2], system[4], system[5]
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    # (h^-1 + floor)^-1 = h (1 + floor h)^-1, which needs no inverse of a blind h.
    a = np.empty((3, 3))
    for i in range(3):
        floor = floor_rot * floor_rot if i == 2 else floor_trans * floor_trans
        for j in range(3):
            h[i, j] /= spread
            a[i, j] = floor * h[i, j]
        a[i, i] += 1.0
    inverse = np.empty((3, 3))
    invert3(a, inverse)
    for i in range(3):
        for j in range(3):
            a[i, j] = h[i, 0] * inverse[0, j] + h[i, 1] * inverse[1, j] + h[i, 2] * inverse[2, j]
    for i in range(3):
        for j in range(3):
            information[i, j] = 0.5 * (a[i, j] + a[j, i])


@njit(cache=True, nogil=True)
def combine(information, known, covariance):
    """(3, 3) covariance of match and prior together; `known` is the prior's information."""
    total = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total[i, j] = information[i, j] + known[i, j]
    invert3(total, covariance)


@njit(cache=True, nogil=True)
def weakest_axis(information, known):
    """Direction (rad) of the translation that the match knows worst, and by what ratio.

    The ratio is the match's own sigma over the sigma that `known` (3, 3), the prior's
    covariance, promises along the same axis: above one, the axis belongs to the odometry.
    Heading is marginalised.
    """
    turn = information[2, 2]
    a, b, c = information[0, 0], information[0, 1], information[1, 1]
    if turn > 0.0:
        a -= information[0, 2] * information[0, 2] / turn
        b -= information[0, 2] * information[1, 2] / turn
        c -= information[1, 2] * information[1, 2] / turn
    low, _, angle = eigen2(a, b, c)
    x, y = np.cos(angle), np.sin(angle)
    promised = known[0, 0] * x * x + 2.0 * known[0, 1] * x * y + known[1, 1] * y * y
    return angle, np.sqrt(1.0 / (max(low, 1e-12) * promised))
