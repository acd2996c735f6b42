"""Numba kernels of the point-to-line matcher: correspondence search and normal equations.

Nothing here allocates inside an iteration, and nothing depends on threads or on the order
of a parallel reduction, so that equal inputs give equal bits.
"""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import inlined, merged, part
from slam.frontend.scan_kernels import LINE, VALID

# A step smaller than this (m) leaves the pairs as they are: neighbours share their lines anyway.
SAME_PAIRS = 0.02
FARTHEST_BEAM = 1e9  # an integer of 32 bits holds no more; no laser has as many
UNASKED = 2  # beams to either side at which the walk looks before it asks whether to end

# Layout of the sums that one pass fills: H (upper triangle, 6), g (3), and then
COST = 9  # robust squared residuals
WEIGHT = 10  # sum of weights
PAIRS = 11  # pairs, over all references
FEIGNED = 12  # information that noisy normals feign: xx, xy, yy
TRIED = 15  # source beams
INLIERS = 16  # pairs with a residual below the scale
PAIRED = 17  # source beams with a partner in any reference
FITTING = 18  # source beams that fit any reference
FEIGNED_TURN = 19  # information of the heading that rests on too few pairs
SYSTEM = 20


@inlined
def bearing_of(y, x):
    """atan2 to 2e-4 rad, enough to find the beam where the search begins."""
    ax, ay = abs(x), abs(y)
    big, small = max(ax, ay), min(ax, ay)
    t = small / max(big, 5e-324)  # 0 at the origin
    t2 = t * t
    # Odd minimax polynomial of atan on [0, 1].
    angle = t * (
        0.9998660 + t2 * (-0.3302995 + t2 * (0.1801410 + t2 * (-0.0851330 + t2 * 0.0208351)))
    )
    if ay > ax:
        angle = 0.5 * np.pi - angle
    if x < 0.0:
        angle = np.pi - angle
    return -angle if y < 0.0 else angle


@inlined
def beam_towards(vx, vy, angle_min, step, whole):
    """Index of the beam that looks at (vx, vy) m from the laser, of `whole` in a turn."""
    turn = bearing_of(vy, vx) - angle_min
    turn = turn + 2.0 * np.pi if turn < 0.0 else turn
    turn = turn - 2.0 * np.pi if turn >= 2.0 * np.pi else turn
    beam = turn / step + 0.5
    beam = beam - whole if beam >= whole else beam
    beam = beam if beam >= 0.0 else 0.0  # nan, which no integer can stand for
    return np.int32(beam if beam < FARTHEST_BEAM else FARTHEST_BEAM)


@inlined
def nearest_from(px, py, centre, points, first, n, geometries, reach2, ref, gate2):
    """Index (from `first`) of the point nearest to (px, py) and its squared distance.

    Walks outwards in bearing from the beam `centre` that looks at (px, py); a point seen k beams
    away is at least r sin((k - 1/2) step) far, less what `bearing_of` errs, which ends the walk.
    The walk goes round the whole circle, also where it has no beams, for what lies outside the
    field of view may be nearest to either end of it.
    `reach2` (1 or references, m) holds sin^2 of those angles up to 90 degrees.  (-1, gate2) if
    none is near; beams without a point hold nan and are never near.  Rows are indexed here, not
    sliced by the caller: a slice an evaluation costs more than the whole search.
    """
    whole = int(geometries[ref, 4])
    vx, vy = px - geometries[ref, 2], py - geometries[ref, 3]
    r2 = vx * vx + vy * vy
    best, best2, k = -1, gate2, 1
    row, last = min(ref, len(reach2) - 1), reach2.shape[1] - 1
    farthest = min(whole // 2, n)
    if centre >= n:  # outside the field of view: there is nothing before the nearer end
        k = min(centre - n + 1, whole - centre)
        farthest = min(whole // 2, k + n - 1)
    else:
        dx, dy = points[first + centre, 0] - px, points[first + centre, 1] - py
        d2 = dx * dx + dy * dy
        if d2 < best2:
            best, best2 = centre, d2
        # Nearly all walks end where there are beams on both sides, and after a step or two: those
        # are taken unasked.  No branches on distances: the processor could not foresee them.
        inner = min(min(centre, n - 1 - centre), min(last, farthest))
        at = first + centre
        while k <= inner and (k <= UNASKED or r2 * reach2[row, k] <= best2):
            ahead, behind = np.uintp(at + k), np.uintp(at - k)  # signed ones may count back
            dx, dy = points[ahead, 0] - px, points[ahead, 1] - py
            d2 = dx * dx + dy * dy
            dx, dy = points[behind, 0] - px, points[behind, 1] - py
            e2 = dx * dx + dy * dy
            best = centre + k if d2 < best2 else best
            best2 = d2 if d2 < best2 else best2
            best = centre - k if e2 < best2 else best
            best2 = e2 if e2 < best2 else best2
            k += 1
    while k <= farthest and not r2 * reach2[row, min(k, last)] > best2:
        up, down = centre + k, centre - k
        if up >= whole:
            up -= whole
        if down < 0:
            down += whole
        if up < n:
            dx, dy = points[first + up, 0] - px, points[first + up, 1] - py
            d2 = dx * dx + dy * dy
            if d2 < best2:
                best, best2 = up, d2
        if down < n:
            dx, dy = points[first + down, 0] - px, points[first + down, 1] - py
            d2 = dx * dx + dy * dy
            if d2 < best2:
                best, best2 = down, d2
        k += 1
    return best, best2


@part
def nearest_beam(px, py, points, first, n, geometries, reach2, ref, gate2):
    """As `nearest_from`, from the beam that looks at (px, py)."""
    vx, vy = px - geometries[ref, 2], py - geometries[ref, 3]
    angle_min, step, whole = geometries[ref, 0], geometries[ref, 1], int(geometries[ref, 4])
    centre = beam_towards(vx, vy, angle_min, step, whole)
    return nearest_from(px, py, centre, points, first, n, geometries, reach2, ref, gate2)


@inlined
def in_reference(poses, ref, x, y, theta):
    """reference_T_source as (cos, sin, x, y), from target_T_source = (x, y, theta)."""
    c, s = np.cos(theta - poses[ref, 2]), np.sin(theta - poses[ref, 2])
    cr, sr = np.cos(poses[ref, 2]), np.sin(poses[ref, 2])
    dx, dy = x - poses[ref, 0], y - poses[ref, 1]
    return c, s, cr * dx + sr * dy, cr * dy - sr * dx


@part
def aim(source_points, source_flags, stride, geometries, transforms, partners):
    """Fill `partners` with the beam that looks at each point; -1 for beams without a point.

    A loop of its own: what the walk takes depends on the data, and would hold this up.
    """
    for ref in range(len(transforms)):
        c, s, tx, ty = (
            transforms[ref, 0],
            transforms[ref, 1],
            transforms[ref, 2] - geometries[ref, 2],
            transforms[ref, 3] - geometries[ref, 3],
        )
        angle_min, step, whole = geometries[ref, 0], geometries[ref, 1], int(geometries[ref, 4])
        for i in range(0, len(source_points), stride):
            qx, qy = source_points[i, 0], source_points[i, 1]
            vx, vy = c * qx - s * qy + tx, s * qx + c * qy + ty
            beam = beam_towards(vx, vy, angle_min, step, whole)
            partners[ref, i] = beam if source_flags[i] & VALID else -1


@part
def accumulate(
    source_points,
    source_lines,
    source_flags,
    stride,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    x,
    y,
    theta,
    gate,
    scale,
    search,
    partners,
    transforms,
    system,
):
    """One pass over all pairs at target_T_source = (x, y, theta); fills `system` (SYSTEM,).

    Residuals are n . p - d in the frame of each reference; derivatives are with respect to a
    step (x, y, theta) in the source frame, pose * Exp(step).  Weights: Geman-McClure.
    `partners` (references, beams) keeps the pairs: looked for anew if `search`, else taken as
    they are.  `transforms` (references, 4) is scratch for cos, sin, x, y of reference_T_source.
    """
    # Sums in plain variables: array elements could alias the inputs and be stored each time.
    hxx = hxy = hxt = hyy = hyt = htt = 0.0
    gx = gy = gt = cost = weight = 0.0
    fxx = fxy = fyy = 0.0
    pairs = tried = inliers = beams_paired = beams_fitting = 0
    gate2 = gate * gate
    inverse_scale2 = 1.0 / (scale * scale)
    for ref in range(len(transforms)):
        c, s, tx, ty = in_reference(poses, ref, x, y, theta)
        transforms[ref, 0], transforms[ref, 1] = c, s
        transforms[ref, 2], transforms[ref, 3] = tx, ty
    if search:
        aim(source_points, source_flags, stride, geometries, transforms, partners)
    for i in range(0, len(source_points), stride):
        if not source_flags[i] & VALID:
            continue
        qx, qy = source_points[i, 0], source_points[i, 1]
        tried += 1
        paired = False
        fits = False
        for ref in range(len(transforms)):
            c, s = transforms[ref, 0], transforms[ref, 1]
            px, py = c * qx - s * qy + transforms[ref, 2], s * qx + c * qy + transforms[ref, 3]
            if search:
                first, n = starts[ref], starts[ref + 1] - starts[ref]
                centre = partners[ref, i]
                j, _ = nearest_from(
                    px, py, centre, points, first, n, geometries, reach2, ref, gate2
                )
                if j >= 0:
                    j = j + first if flags[first + j] & LINE else -1
                partners[ref, i] = j
            else:
                j = partners[ref, i]
            if j < 0:
                continue
            nx, ny = lines[j, 0], lines[j, 1]
            # The normal in the source frame.
            ax, ay = c * nx + s * ny, c * ny - s * nx
            if source_flags[i] & LINE and ax * source_lines[i, 0] + ay * source_lines[i, 1] < 0.5:
                partners[ref, i] = -1
                continue
            residual = nx * px + ny * py - lines[j, 2]
            if abs(residual) > gate:
                partners[ref, i] = -1
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
            pairs += 1
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
    system[COST], system[WEIGHT], system[PAIRS] = cost, weight, pairs
    system[FEIGNED], system[FEIGNED + 1], system[FEIGNED + 2] = fxx, fxy, fyy
    system[TRIED], system[INLIERS] = tried, inliers
    system[PAIRED], system[FITTING], system[FEIGNED_TURN] = beams_paired, beams_fitting, 0.0


@part
def eigen2(a, b, c):
    """Smaller and larger eigenvalue of [[a, b], [b, c]] and the direction (rad) of the smaller."""
    half = 0.5 * (a + c)
    root = np.sqrt(0.25 * (a - c) * (a - c) + b * b)
    # The larger eigenvalue's direction is half the angle of (a - c, 2 b).
    return half - root, half + root, 0.5 * np.arctan2(2.0 * b, a - c) + 0.5 * np.pi


@merged
def quiet_blind_axis(system):
    """Shrink the gradient along the axis that only noisy normals seem to see.

    Pairs move along a plain wall with the scan, so no residual ever ends a push along it: what
    pushes there is noise, and only the prior would hold against it.  The gradient keeps the
    share of the information that is real.
    """
    turn = max(system[5], 1e-300)
    xx = system[0] - system[2] * system[2] / turn
    xy = system[1] - system[2] * system[4] / turn
    yy = system[3] - system[4] * system[4] / turn
    low, _, angle = eigen2(xx, xy, yy)
    x, y = np.cos(angle), np.sin(angle)
    feigned = (
        system[FEIGNED] * x * x + 2.0 * system[FEIGNED + 1] * x * y + system[FEIGNED + 2] * y * y
    )
    if feigned > 0.0:
        surplus = min(feigned / max(low, 1e-300), 1.0)
        along = surplus * (x * system[6] + y * system[7])
        system[6] -= along * x
        system[7] -= along * y


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
def gauss_newton(
    source_points,
    source_lines,
    source_flags,
    stride,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    pose,
    prior,
    information,
    noise,
    gate,
    scale,
    iterations,
    tolerance,
    partners,
    transforms,
    scratch,
    system,
):
    """Iterate from `pose` (3,), which it overwrites; returns (size of the last step, count).

    Minimises sum rho(residual) / noise^2 + the prior's squared distance; `information` (3, 3) is
    that of the step from `prior` (3,) in the prior's own frame, zero for no prior.  The size of
    the last step is in m (radians count fivefold) and inf if the system became singular.
    `transforms` (references, 4) and `scratch` (4, 6) are for its own use.
    """
    a, g, step, before = scratch[0], scratch[1], scratch[2], scratch[3]
    for k in range(3):
        step[k] = before[k] = 0.0
    inverse = stride / (noise * noise)
    damping = 1.0
    size = np.inf
    for iteration in range(iterations):
        accumulate(
            source_points,
            source_lines,
            source_flags,
            stride,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose[0],
            pose[1],
            pose[2],
            gate,
            scale,
            size > SAME_PAIRS,
            partners,
            transforms,
            system,
        )
        quiet_blind_axis(system)
        for k in range(6):
            a[k] = system[k] * inverse
        # The prior's error, in the frame of the current pose (rotation differences are small).
        c, s = np.cos(pose[2]), np.sin(pose[2])
        dx, dy = pose[0] - prior[0], pose[1] - prior[1]
        e0, e1 = c * dx + s * dy, c * dy - s * dx
        e2 = pose[2] - prior[2]
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
        if system[PAIRS] < 3.0 or not solve3(a, g, step):
            return np.inf, iteration + 1
        # Pairs that change partner to and fro make the iteration swing: shorten its steps.
        if iteration > 5 and step[0] * before[0] + step[1] * before[1] + step[2] * before[2] < 0.0:
            damping = max(0.5 * damping, 0.1)
        # One step never leaves the reach of the pairs that suggested it.
        length = np.sqrt(step[0] * step[0] + step[1] * step[1])
        shorten = damping * min(1.0, gate / max(length, 1e-12), 0.5 / max(abs(step[2]), 1e-12))
        for k in range(3):
            step[k] *= shorten
            before[k] = step[k]
        # pose * Exp(step), the exponential to second order: steps are small and shrinking.
        half = 0.5 * step[2]
        ux, uy = step[0] - half * step[1], step[1] + half * step[0]
        pose[0] += c * ux - s * uy
        pose[1] += s * ux + c * uy
        pose[2] += step[2]
        size = max(abs(step[0]) + abs(step[1]), 5.0 * abs(step[2]))
        if size < tolerance:
            return size, iteration + 1
    return size, iterations
