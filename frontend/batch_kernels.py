"""Many scans, each matched among its own choice of keyframes, in one call of a kernel."""

from __future__ import annotations

import math

import numpy as np
from slam.frontend.compiled import allocating_part, kernel, part

# Columns of what is found of each scan.
X, Y, THETA, LAST_STEP, PAIRS, INLIERS, FITTING, TRIED = range(8)
FOUND = 8


@kernel
def align_each(align, scans, keyframes, near, guesses, covariance, passes, others, limits, found):
    """Call `align` for each scan, from its guess, which is its prior as well.

    Poses are composed as GTSAM does it, to the bit.  Whose guess is not finite, or who has fewer
    beams than `min_pairs`, is left as it is.

    Args:
        align: the kernel, by its address (`kernel_address.Address`).
        scans: points, lines and flags of b scans end to end, starts (b + 1,), geometries (b, 5) and
            how many beams are valid (b,).
        keyframes: the fields of `References` with all keyframes of the batch; poses are map_T_base.
        near: (b, k) the keyframes of each scan; the target frame is that of the first.
        guesses: (b, 3) map_T_base.
        covariance: (3, 3) of the error of a guess.
        passes: as for `align`.
        others: as for `align`.
        limits: as for `align`.
        found: (b, FOUND) is filled: x (m), y (m) and theta (rad) of target_T_source, size of the
            last step (m), and numbers of pairs, inliers, beams that fit and that were tried.
    """
    points, lines, flags, starts, geometries, valid = scans
    poses = keyframes[7]
    count = near.shape[1]
    for scan in range(len(guesses)):
        at = guesses[scan]
        if valid[scan] < limits[5] or not math.isfinite(at[0] + at[1] + at[2]):
            continue
        base = poses[near[scan, 0]]
        begin, end = starts[scan], starts[scan + 1]
        stack = gathered(keyframes, near[scan])
        for k in range(count):
            x, y, theta = between(base, poses[near[scan, k]])
            stack[7][k, 0], stack[7][k, 1], stack[7][k, 2] = x, y, theta
        start = between(base, at)
        result = align(
            (points[begin:end], lines[begin:end], flags[begin:end], geometries[scan]), stack,
            start, (start, covariance, True), passes, others, limits,
        )  # fmt: skip
        row = found[scan]
        row[X], row[Y], row[THETA] = result[0], result[1], result[2]
        row[LAST_STEP], row[PAIRS], row[INLIERS] = result[5], result[9], result[10]
        row[FITTING], row[TRIED] = result[12], result[13]


@allocating_part
def gathered(keyframes, chosen):
    """The fields of `References` for a choice of keyframes (k,), end to end; poses are not filled.

    Element by element: assigning rows to slices would compile checks with messages, for seconds.
    """
    points, lines, windows, flags, starts, geometries, reach2, _ = keyframes
    count, total = len(chosen), 0
    first = np.empty(count + 1, dtype=np.int64)
    for k in range(count):
        first[k] = total
        total += starts[chosen[k] + 1] - starts[chosen[k]]
    first[count] = total
    own_points, own_lines = np.empty((total, 2)), np.empty((total, 5))
    own_windows, own_flags = np.empty((total, 2), np.int32), np.empty(total, np.uint8)
    own_geometries = np.empty((count, 5))
    for k in range(count):
        row = starts[chosen[k]] - first[k]
        for i in range(first[k], first[k + 1]):
            for m in range(2):
                own_points[i, m] = points[row + i, m]
                own_windows[i, m] = windows[row + i, m]
            for m in range(5):
                own_lines[i, m] = lines[row + i, m]
            own_flags[i] = flags[row + i]
        for m in range(5):
            own_geometries[k, m] = geometries[chosen[k], m]
    return (
        own_points, own_lines, own_windows, own_flags, first, own_geometries, reach2,
        np.empty((count, 3)),
    )  # fmt: skip


@part
def between(a, b):
    """a^-1 b of poses (x, y, theta), with the roundings of `gtsam.Pose2.between`."""
    ca, sa, cb, sb = math.cos(a[2]), math.sin(a[2]), math.cos(b[2]), math.sin(b[2])
    c, s = ca * cb + sa * sb, ca * sb - sa * cb
    square = c * c + s * s
    if abs(square - 1.0) > 1e-10:
        scale = 1.0 / math.sqrt(square)
        c, s = c * scale, s * scale
    x = (sa * -a[1] - ca * a[0]) + (ca * b[0] + sa * b[1])
    y = (sa * a[0] - ca * a[1]) + (ca * b[1] - sa * b[0])
    return x, y, math.atan2(s, c)


@kernel
def views(guesses, centres, out):
    """Fill `out` (n, 4) with what scans with `centres` (n, 2) look at from (n, 3), and from where.

    In m, with the roundings of `gtsam.Pose2.transformFrom`.
    """
    for k in range(len(guesses)):
        c, s = math.cos(guesses[k, 2]), math.sin(guesses[k, 2])
        x, y = centres[k, 0], centres[k, 1]
        out[k, 0] = (c * x - s * y) + guesses[k, 0]
        out[k, 1] = (s * x + c * y) + guesses[k, 1]
        out[k, 2], out[k, 3] = guesses[k, 0], guesses[k, 1]
