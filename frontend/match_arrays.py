"""What the matcher's kernels hand each other: records of arrays, and the layout of their sums.

Lengths are in m, angles in rad.  `target` is the frame that the references stand in, `source` the
base frame of the scan that is matched.

Python hands over plain tuples with the fields of these records in their order, and the kernel makes
the records of them: numba takes 10 us longer to read named tuples than plain ones, a tenth of
a match.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Layout of the sums that one iteration fills: H (upper triangle: xx, xy, xt, yy, yt, tt) at 0,
# the gradient g (3) at 6, and then
COST = 9  # robust squared residuals, m^2
WEIGHT = 10  # sum of weights
PAIRS = 11  # pairs, over all references
SPURIOUS = 12  # information that only the noise of the normals adds: xx, xy, yy
TRIED = 15  # source beams
INLIERS = 16  # pairs with a residual below the scale
PAIRED = 17  # source beams with a correspondence in any reference
FITTING = 18  # source beams that fit any reference
SPURIOUS_TURN = 19  # information of the heading that rests on too few pairs
SYSTEM = 20


class Source(NamedTuple):
    """The scan that is matched, n beams in its base frame (see `PreparedScan`)."""

    points: Floats  # (n, 2) m; nan where the beam brought nothing back
    lines: Floats  # (n, 5) normal x, y, offset (m), variance of the angle (rad^2), middle (m)
    flags: NDArray[np.uint8]  # (n,) VALID | LINE
    geometry: Floats  # (5,) angle_min (rad), step (rad), laser x, y (m), beams in a turn


class References(NamedTuple):
    """The scans that are matched against, m of them, end to end; each in its own base frame."""

    points: Floats  # (sum n, 2)
    lines: Floats  # (sum n, 5)
    windows: NDArray[np.int32]  # (sum n, 2) first and last beam of each line, from the scan's own 0
    flags: NDArray[np.uint8]  # (sum n,)
    starts: NDArray[np.int64]  # (m + 1,) scan k holds the rows starts[k] to starts[k + 1] - 1
    geometries: Floats  # (m, 5)
    reach2: Floats  # (1 or m, REACH) sin^2 of the least angle to beam k; one row may serve all
    poses: Floats  # (m, 3) target_T_reference: x, y, theta


class PriorTerm(NamedTuple):
    """A quadratic pull towards a pose."""

    pose: Floats  # (3,) target_T_source
    information: Floats  # (3, 3) of the error in the prior's own frame; zero: no prior


class Limits(NamedTuple):
    """The settings of `align`, see `MatchConfig`."""

    noise: float  # m, one sigma of a range
    variance: float  # m^2, of a range, with what the covariance is widened by
    floor_trans: float  # m
    floor_rot: float  # rad
    iterations: int  # per pass
    min_pairs: int
    good_inlier_fraction: float


class Pass(NamedTuple):
    """One pass of Gauss-Newton iterations, coarse or fine."""

    gate: float  # m, residuals beyond make no pair
    scale: float  # m, of the robust weight: a pair at this residual weighs 1/4
    tolerance: float  # m, a smaller step ends the pass
    stride: int  # of the source beams that take part
    noise: float  # m, one sigma of a residual, against which the prior is weighed
    iterations: int  # at most


class Workspace(NamedTuple):
    """What the kernels of a match write to; allocated once, since no iteration allocates."""

    pairs: NDArray[np.int32]  # (m, n) the row of each source beam's correspondence; -1: none
    system: Floats  # (SYSTEM,) sums of the last iteration
    transforms: Floats  # (m, 4) reference_T_source: cos, sin, x, y
    scratch: Floats  # (4, 6) rows of `gauss_newton`
    direction: Floats  # (4,) weak direction: x, y, theta per metre, and the information left there
    strongest: Floats  # (STRONGEST_PAIRS,) information of the pairs that hold most of it
