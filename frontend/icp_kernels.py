"""Numba kernels of the point-to-line matcher: normal equations and Gauss-Newton steps.

Nothing here allocates inside an iteration, and nothing depends on threads or on the order
of a parallel reduction, so that equal inputs give equal bits.
"""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import merged, part
from slam.frontend.correspondence_kernels import (
    MIN_NORMAL_COSINE,
    in_reference,
    nearest_from,
    seed_search,
)
from slam.frontend.degeneracy import quiet_spurious_gradient
from slam.frontend.match_arrays import (
    COST,
    FITTING,
    INLIERS,
    PAIRED,
    PAIRS,
    SPURIOUS,
    SPURIOUS_TURN,
    TRIED,
    WEIGHT,
)
from slam.frontend.scan_kernels import LINE, VALID

# A step smaller than this (m) leaves the pairs as they are: neighbours share their lines anyway.
SAME_PAIRS = 0.02
MIN_PAIRS = 3.0  # pairs that a step of three unknowns needs
LARGEST_TURN = 0.5  # rad in one step: small angles are assumed, and pairs found by bearing
TURN_COUNTS = 5.0  # m per rad, in the size of a step: the distance of what a laser mostly sees
# Iterations after which a step back halves all later ones, down to a tenth: pairs that change to
# and fro make the iteration swing, which takes a few steps to show.
UNDAMPED = 5
LEAST_DAMPING = 0.1


@part
def accumulate(source, references, pose, level, search, work):
    """One iteration over all pairs at `pose` (3,), target_T_source; fills `work.system`.

    Residuals are n . p - d in the frame of each reference; derivatives are with respect to a
    step (x, y, theta) in the source frame, pose * Exp(step).  Weights: Geman-McClure.
    Correspondences are looked for anew if `search`, else taken as `work.pairs` has them.
    """
    # Sums in plain variables: array elements could alias the inputs and be stored each time.
    hxx = hxy = hxt = hyy = hyt = htt = 0.0
    gx = gy = gt = cost = weight = 0.0
    fxx = fxy = fyy = 0.0
    count = tried = inliers = beams_paired = beams_fitting = 0
    gate, scale, stride = level.gate, level.scale, level.stride
    gate2 = gate * gate
    inverse_scale2 = 1.0 / (scale * scale)
    pairs, system, transforms = work.pairs, work.system, work.transforms
    points, lines = source.points, references.lines
    x, y, theta = pose[0], pose[1], pose[2]
    for ref in range(len(transforms)):
        c, s, tx, ty = in_reference(references.poses, ref, x, y, theta)
        transforms[ref, 0], transforms[ref, 1] = c, s
        transforms[ref, 2], transforms[ref, 3] = tx, ty
    if search:
        seed_search(source, stride, references, transforms, pairs)
    for i in range(0, len(points), stride):
        if not source.flags[i] & VALID:
            continue
        qx, qy = points[i, 0], points[i, 1]
        tried += 1
        paired = False
        fits = False
        for ref in range(len(transforms)):
            c, s = transforms[ref, 0], transforms[ref, 1]
            px, py = c * qx - s * qy + transforms[ref, 2], s * qx + c * qy + transforms[ref, 3]
            if search:
                j, _ = nearest_from(px, py, pairs[ref, i], references, ref, gate2)
                if j >= 0:
                    j += references.starts[ref]
                    j = j if references.flags[j] & LINE else -1
                pairs[ref, i] = j
            else:
                j = pairs[ref, i]
            if j < 0:
                continue
            nx, ny = lines[j, 0], lines[j, 1]
            # The normal in the source frame.
            ax, ay = c * nx + s * ny, c * ny - s * nx
            cosine = ax * source.lines[i, 0] + ay * source.lines[i, 1]
            if source.flags[i] & LINE and cosine < MIN_NORMAL_COSINE:
                pairs[ref, i] = -1
                continue
            residual = nx * px + ny * py - lines[j, 2]
            if abs(residual) > gate:
                pairs[ref, i] = -1
                continue
            paired = True
            at = ay * qx - ax * qy
            root = 1.0 / (1.0 + residual * residual * inverse_scale2)
            w = root * root
            wax, way, wat = w * ax, w * ay, w * at
            hxx += wax * ax
            hxy += wax * ay
            hxt += wax * at
            hyy += way * ay
            hyt += way * at
            htt += wat * at
            gx += wax * residual
            gy += way * residual
            gt += wat * residual
            cost += residual * residual * root
            weight += w
            count += 1
            v = w * lines[j, 3]
            fxx += v * ay * ay
            fxy -= v * ax * ay
            fyy += v * ax * ax
            if residual * residual * inverse_scale2 < 1.0:
                inliers += 1
                fits = True
        if paired:
            beams_paired += 1
        if fits:
            beams_fitting += 1
    system[0], system[1], system[2] = hxx, hxy, hxt
    system[3], system[4], system[5] = hyy, hyt, htt
    system[6], system[7], system[8] = gx, gy, gt
    system[COST], system[WEIGHT], system[PAIRS] = cost, weight, count
    system[SPURIOUS], system[SPURIOUS + 1], system[SPURIOUS + 2] = fxx, fxy, fyy
    system[TRIED], system[INLIERS] = tried, inliers
    system[PAIRED], system[FITTING], system[SPURIOUS_TURN] = beams_paired, beams_fitting, 0.0


@part
def solve3(a, g, step):
    """Solve the 3x3 system (upper triangle a, 6) for -g by Cholesky; False if singular."""
    if not a[0] > 0.0:
        return False
    l00 = np.sqrt(a[0])
    l10, l20 = a[1] / l00, a[2] / l00
    d1 = a[3] - l10 * l10
    if not d1 > 1e-12 * a[3]:
        return False
    l11 = np.sqrt(d1)
    l21 = (a[4] - l20 * l10) / l11
    d2 = a[5] - l20 * l20 - l21 * l21
    if not d2 > 1e-12 * a[5]:
        return False
    l22 = np.sqrt(d2)
    u0 = -g[0] / l00
    u1 = (-g[1] - l10 * u0) / l11
    u2 = (-g[2] - l20 * u0 - l21 * u1) / l22
    step[2] = u2 / l22
    step[1] = (u1 - l21 * step[2]) / l11
    step[0] = (u0 - l10 * step[1] - l20 * step[2]) / l00
    return True


@merged
def gauss_newton(source, references, pose, prior, level, work):
    """Iterate from `pose` (3,), which it overwrites; returns (size of the last step, count).

    Minimises sum rho(residual) / noise^2 + the prior's squared distance.  The size of the last
    step is in m (radians count TURN_COUNTS m each), and inf if the system became singular.
    """
    system, scratch = work.system, work.scratch
    a, g, step, before = scratch[0], scratch[1], scratch[2], scratch[3]
    centre, information = prior.pose, prior.information
    stride, noise, gate = level.stride, level.noise, level.gate
    for k in range(3):
        step[k] = before[k] = 0.0
    inverse = stride / (noise * noise)
    damping = 1.0
    size = np.inf
    for iteration in range(level.iterations):
        accumulate(source, references, pose, level, size > SAME_PAIRS, work)
        quiet_spurious_gradient(system)
        for k in range(6):
            a[k] = system[k] * inverse
        # The prior's error, in the frame of the current pose (rotation differences are small).
        c, s = np.cos(pose[2]), np.sin(pose[2])
        dx, dy = pose[0] - centre[0], pose[1] - centre[1]
        e0, e1 = c * dx + s * dy, c * dy - s * dx
        e2 = pose[2] - centre[2]
        e2 -= 2.0 * np.pi * np.floor(e2 / (2.0 * np.pi) + 0.5)
        a[0] += information[0, 0]
        a[1] += information[0, 1]
        a[2] += information[0, 2]
        a[3] += information[1, 1]
        a[4] += information[1, 2]
        a[5] += information[2, 2]
        for k in range(3):
            g[k] = system[6 + k] * inverse
            g[k] += information[k, 0] * e0 + information[k, 1] * e1 + information[k, 2] * e2
        if system[PAIRS] < MIN_PAIRS or not solve3(a, g, step):
            return np.inf, iteration + 1
        # Pairs that change to and fro make the iteration swing: shorten its steps.
        forth = step[0] * before[0] + step[1] * before[1] + step[2] * before[2]
        if iteration > UNDAMPED and forth < 0.0:
            damping = max(0.5 * damping, LEAST_DAMPING)
        # One step never leaves the reach of the pairs that suggested it.
        length = np.sqrt(step[0] * step[0] + step[1] * step[1])
        turn = max(abs(step[2]), 1e-12)
        shorten = damping * min(1.0, gate / max(length, 1e-12), LARGEST_TURN / turn)
        for k in range(3):
            step[k] *= shorten
            before[k] = step[k]
        # pose * Exp(step), the exponential to second order: steps are small and shrinking.
        half = 0.5 * step[2]
        ux, uy = step[0] - half * step[1], step[1] + half * step[0]
        pose[0] += c * ux - s * uy
        pose[1] += s * ux + c * uy
        pose[2] += step[2]
        size = max(abs(step[0]) + abs(step[1]), TURN_COUNTS * abs(step[2]))
        if size < level.tolerance:
            return size, iteration + 1
    return size, level.iterations
