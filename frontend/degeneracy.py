"""Directions in which scans do not constrain a pose: one definition, and every threshold.

The definition: of the information matrix of (x, y, theta) the heading is marginalised (its Schur
complement is taken), and what remains of the translation, 2 by 2, has a weaker eigenvector, the
*weak direction*, with the information left there.  Where the weak direction is decided on,
one of three quantities is compared:

- its information with that of the strong direction (the *condition ratio* of the match);
- its sigma with the sigma that other knowledge has there (a prior, a length in m);
- the information that the cost bears out with that which the normal equations claim (*spurious
  information*: noisy normals and single wrong pairs make a plain wall look informative).

Zhang, Kaess and Singh 2016 ("On degeneracy of optimization-based state estimation problems") name
the smallest eigenvalue of H as the measure and keep the solution from moving along such
directions.  X-ICP (Tuna et al. 2023) asks for each direction how many pairs, and how strong ones,
contribute to it, and adds constraints where they are few; the test of the strongest pairs here
has the same aim.  Both compare with thresholds in units of H, tuned to a sensor.  Here H is divided
by the noise of a range, so that thresholds are lengths or ratios, and the decision is soft: a
degenerate direction keeps the information that it shows, and the prior does the rest.  Censi (2007,
"An accurate closed-form estimate of ICP's covariance"; 2008, "An ICP variant using a point-to-line
metric") derives the covariance from how the gradient scatters, which `own_information` follows;
Landry et al. and Bonnabel et al. have shown that it is too small where pairs change along
a wall, which is why spurious information is taken out first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from slam.frontend.compiled import inlined, merged, part
from slam.frontend.match_arrays import SPURIOUS

Matrix = NDArray[np.float64]

# Within a match: when the weak direction has to prove its information, and how.
# Ratio of information, weak over strong.  0.2 is a sigma ratio of 2.2; plain rooms stay above it.
PROOF_RATIO = 0.2
PROOF_SHIFT = 3.0  # robust scales to either side that the scan is shifted by for the proof
TRUSTED_SHARE = 0.5  # of its information that the weak direction must show to be left alone
# Pairs: single wrong ones that hold most of the information come in ones and twos, rarely threes.
STRONGEST_PAIRS = 3
# Information of the strongest pairs over that of all others, at most: a third of the whole.
STRONGEST_LIMIT = 0.5
# Share of the translation's information that is added to it when the heading's is marginalised,
# so that the shift which goes with a turn stays bounded along a degenerate direction.
HEADING_RIDGE = 1e-3

# After a match: own sigma over the prior's along the weak direction.  Above 1 the prior knows it
# better, and the match reports the direction as degenerate.
DEGENERATE_RATIO = 1.0
LEAST_INFORMATION = 1e-12  # 1/m^2, in place of none at all: a sigma of 1000 km

# Of a loop closure, whose prior is only a seed: here the sigma itself counts, in m.  Matches of
# places with features have millimetres; those that slide along a wall have centimetres and more.
UNSEEN_SIGMA_M = 0.02
# Ratio of sigmas, weak over strong, from which it is asked from which side the place was seen.
# Not PROOF_RATIO (2.2 as a ratio of sigmas): that starts a test that measures, this one starts a
# geometric suspicion, which must not fall on rooms that are merely oblong.
LOOP_SIGMA_RATIO = 2.5
BOTH_SIDES_SHARE = 0.5  # of the nearer points between both lasers: most of what is seen
NEAR_M = 10.0  # m, points that decide from which side a place is seen


@merged
def taken_by_heading(xt, yt, tt):
    """Information (xx, xy, yy) that the translation loses because the heading is unknown too."""
    turn = max(tt, 1e-300)
    return xt * xt / turn, xt * yt / turn, yt * yt / turn


@part
def weak_direction(xx, xy, yy):
    """Smaller and larger eigenvalue of [[xx, xy], [xy, yy]]; direction (rad) of the smaller."""
    half = 0.5 * (xx + yy)
    root = np.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
    # The larger eigenvalue's direction is half the angle of (xx - yy, 2 xy).
    return half - root, half + root, 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi


@merged
def quiet_spurious_gradient(system):
    """Shrink the gradient along the direction that only noisy normals seem to constrain.

    Pairs move along a plain wall with the scan, so no residual ever ends a push along it: what
    pushes there is noise, and only the prior would hold against it.  The gradient keeps the
    share of the information that is real.
    """
    bxx, bxy, byy = taken_by_heading(system[2], system[4], system[5])
    low, _, angle = weak_direction(system[0] - bxx, system[1] - bxy, system[3] - byy)
    x, y = np.cos(angle), np.sin(angle)
    spurious = (
        system[SPURIOUS] * x * x + 2.0 * system[SPURIOUS + 1] * x * y + system[SPURIOUS + 2] * y * y
    )
    if spurious > 0.0:
        surplus = min(spurious / max(low, 1e-300), 1.0)
        along = surplus * (x * system[6] + y * system[7])
        system[6] -= along * x
        system[7] -= along * y


@merged
def weakest_direction(information, known):
    """Weak direction (rad) of an information (3, 3), and its sigma over the one known otherwise.

    `known` (3, 3) is the prior's covariance: above DEGENERATE_RATIO, the odometry knows better.
    """
    bxx, bxy, byy = 0.0, 0.0, 0.0
    if information[2, 2] > 0.0:
        bxx, bxy, byy = taken_by_heading(information[0, 2], information[1, 2], information[2, 2])
    low, _, angle = weak_direction(
        information[0, 0] - bxx, information[0, 1] - bxy, information[1, 1] - byy
    )
    x, y = np.cos(angle), np.sin(angle)
    variance = known[0, 0] * x * x + 2.0 * known[0, 1] * x * y + known[1, 1] * y * y
    return angle, np.sqrt(1.0 / (max(low, LEAST_INFORMATION) * variance))


@inlined
def keep_strongest(information, strongest):
    """Insert a pair's information into the descending list (STRONGEST_PAIRS,) if it belongs."""
    for k in range(STRONGEST_PAIRS):
        if information > strongest[k]:
            information, strongest[k] = strongest[k], information


def weak_sigmas(information: Matrix) -> tuple[Matrix, float, float]:
    """The weak direction of an information matrix, for what is not compiled.

    Its own eigensolver: LAPACK's differs from `weak_direction` in the last bit.

    Args:
        information: (3, 3) of (x, y, theta): 1/m^2, 1/(m rad), 1/rad^2.

    Returns:
        Unit vector (2,) of the weak direction, its sigma and that across it, in m; inf where
        nothing is known.
    """
    turn = max(information[2, 2], 1e-300)
    known = information[:2, :2] - np.outer(information[:2, 2], information[2, :2]) / turn
    values, vectors = np.linalg.eigh(known)
    weak, strong = (1.0 / np.sqrt(v) if v > 0.0 else np.inf for v in values)
    return vectors[:, 0], float(weak), float(strong)


def is_degenerate(condition_ratio: float) -> bool:
    """Whether a match knows its weak direction worse than its prior does."""
    return condition_ratio > DEGENERATE_RATIO


def well_constrained(information: Matrix, sigma: float) -> bool:
    """Whether every translation is known to better than `sigma` (m) where the heading is known.

    The heading is *not* marginalised: this is asked of the one edge that connects two maps, whose
    heading a laser always sees; what may be open is the position along a corridor.

    Args:
        information: (3, 3) of (x, y, theta).
        sigma: m.
    """
    return bool(np.linalg.eigvalsh(information[:2, :2])[0] > 1.0 / sigma**2)
