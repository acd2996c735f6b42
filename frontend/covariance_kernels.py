"""Numba kernels that turn the sums of a match into its information and covariance."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import kernel, merged, part
from slam.frontend.degeneracy import taken_by_heading, weak_direction
from slam.frontend.match_arrays import SPURIOUS, SPURIOUS_TURN

# Added to the scatter M before it is inverted: the share of it that rounding leaves wrong anyway,
# and a number for a match without pairs.
RIDGE = 1e-9
LEAST_RIDGE = 1e-12


@part
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


@part
def multiply3(a, b, out):
    """Product of two (3, 3) matrices."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def own_information(system, gradient, variance, floor_trans, floor_rot, information):
    """(3, 3) information of the match alone, with the spurious part taken out.

    Normals that err by a variance s2 turn the information n n' into n n' + s2 t t': a plain
    wall seems to know where along it the robot is.  The expected surplus is subtracted, as far
    as the difference keeps no negative direction.  The covariance is the sandwich
    H^-1 M H^-1 variance (Censi 2007) of an estimator whose gradient scatters by M (`gradient`, 6)
    for unit noise, plus a floor (m, rad) for what no number of beams removes; all in information
    form, since directions may be degenerate.  `variance` (m^2) is that of a range.
    """
    f = SPURIOUS
    bxx, bxy, byy = taken_by_heading(system[2], system[4], system[5])
    low, high, angle = weak_direction(
        system[0] - bxx - system[f],
        system[1] - bxy - system[f + 1],
        system[3] - byy - system[f + 2],
    )
    low, high = max(low, 0.0), max(high, 0.0)
    c, s = np.cos(angle), np.sin(angle)
    h = np.empty((3, 3))
    h[0, 0] = low * c * c + high * s * s + bxx
    h[0, 1] = (low - high) * c * s + bxy
    h[1, 1] = low * s * s + high * c * c + byy
    h[0, 2], h[1, 2], h[2, 2] = system[2], system[4], system[5] - system[SPURIOUS_TURN]
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    m = np.empty((3, 3))
    m[0, 0], m[0, 1], m[0, 2] = gradient[0], gradient[1], gradient[2]
    m[1, 1], m[1, 2], m[2, 2] = gradient[3], gradient[4], gradient[5]
    m[1, 0], m[2, 0], m[2, 1] = m[0, 1], m[0, 2], m[1, 2]
    ridge = RIDGE * (m[0, 0] + m[1, 1]) + LEAST_RIDGE
    for i in range(3):
        m[i, i] += ridge
    inverse, product, a = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    invert3(m, inverse)
    multiply3(h, inverse, product)
    multiply3(product, h, a)
    # (a^-1 + floor)^-1 = a (1 + floor a)^-1, which needs no inverse of a degenerate a.
    for i in range(3):
        floor = floor_rot * floor_rot if i == 2 else floor_trans * floor_trans
        for j in range(3):
            a[i, j] /= variance
            m[i, j] = floor * a[i, j]
        m[i, i] += 1.0
    invert3(m, inverse)
    multiply3(a, inverse, product)
    for i in range(3):
        for j in range(3):
            information[i, j] = 0.5 * (product[i, j] + product[j, i])


@merged
def combine(information, known, covariance):
    """(3, 3) covariance of match and prior together; `known` is the prior's information."""
    total = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            total[i, j] = information[i, j] + known[i, j]
    invert3(total, covariance)
