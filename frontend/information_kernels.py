"""Numba kernels that predict a match: what the next scan sees of this one, and its information.

The scan's own points, joined along each surface, are the only map there is; a coming scan is
cast into it beam by beam.  What is outside, behind or beyond is not seen and adds nothing.
"""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import kernel, part
from slam.frontend.correspondence_kernels import bearing_of
from slam.frontend.covariance_kernels import own_information
from slam.frontend.match_arrays import SPURIOUS, SYSTEM, Source
from slam.frontend.scan_kernels import LINE, VALID
from slam.frontend.scatter_kernels import add_outer

HIDDEN = -1  # what a beam meets that no match can use: nothing, or a surface from behind


@part
def surfaces(points, flags, geometry, noise, gap_ratio, joined):
    """Set `joined` (n,) where a beam's point and the next one's lie on one surface."""
    n = len(points)
    round_about = n >= int(geometry[4])
    ox, oy = geometry[2], geometry[3]
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        joined[i] = False
        if (j == 0 and not round_about) or not (flags[i] & VALID and flags[j] & VALID):
            continue
        dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        ri = (points[i, 0] - ox) ** 2 + (points[i, 1] - oy) ** 2
        rj = (points[j, 0] - ox) ** 2 + (points[j, 1] - oy) ** 2
        widest = max(gap_ratio * geometry[1] * np.sqrt(min(ri, rj)), 5.0 * noise)
        joined[i] = dx * dx + dy * dy <= widest * widest


@part
def cast(points, joined, geometry, bearings, pose, depth, hit):
    """What each beam of `bearings` (k, 2), unit vectors, meets from `pose` (3,), base_T_later.

    Fills the range `depth` (k,) in m, and in `hit` (k,) the point where the joined pair that was
    met begins, or HIDDEN.
    """
    n, beams = len(points), len(depth)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ox, oy = geometry[2], geometry[3]
    lx, ly = pose[0] + c * ox - s * oy, pose[1] + s * ox + c * oy
    first, step = geometry[0], geometry[1] * (n // beams)
    turn = 2.0 * np.pi / step
    depth[:] = np.inf
    hit[:] = HIDDEN
    known = False  # whether (u, v) and the bearing are already those of point i
    u = v = bearing = 0.0
    for i in range(n):
        if not joined[i]:
            known = False
            continue
        if not known:
            dx, dy = points[i, 0] - lx, points[i, 1] - ly
            u, v = c * dx + s * dy, c * dy - s * dx
            bearing = bearing_of(v, u)
        j = i + 1 if i + 1 < n else 0
        dx, dy = points[j, 0] - lx, points[j, 1] - ly
        u1, v1 = c * dx + s * dy, c * dy - s * dx
        bearing1 = bearing_of(v1, u1)
        across = u * v1 - v * u1  # positive: seen from the same side as now
        begin, end = (bearing, bearing1) if across > 0.0 else (bearing1, bearing)
        if end < begin:
            end += 2.0 * np.pi
        offset = begin - first
        offset -= 2.0 * np.pi * np.floor(offset / (2.0 * np.pi))
        k = int(np.ceil(offset / step))
        last = (offset + end - begin) / step
        while k <= last:
            at = k if k < turn else int(k - turn + 0.5)
            if at < beams:
                slope = bearings[at, 0] * (v1 - v) - bearings[at, 1] * (u1 - u)
                r = across / slope if slope != 0.0 else np.inf
                if 0.0 < r < depth[at]:
                    depth[at] = r
                    hit[at] = i if across > 0.0 else HIDDEN
            k += 1
        u, v, bearing, known = u1, v1, bearing1, True


@part
def weigh(scan, bearings, pose, depth, hit, system, gradient):
    """Sums of the match that the cast beams would make; returns how many of them would pair.

    Fills `system` (SYSTEM,) and the scatter `gradient` (6) for unit range noise, both in the
    frame of the later scan.  Noise acts along the beam, on either side of a pair; a beam
    of this scan stands for as many pairs as later beams fall between it and the next one.
    """
    points, lines, flags, geometry = scan.points, scan.lines, scan.flags, scan.geometry
    system[:] = 0.0
    gradient[:] = 0.0
    n, paired = len(points), 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ox, oy = geometry[2], geometry[3]
    step = geometry[1] * (n // len(bearings))
    for k in range(len(depth)):
        i = hit[k]
        if i < 0:
            continue
        j = i + 1 if i + 1 < n else 0
        bx, by = bearings[k, 0], bearings[k, 1]
        qx, qy = ox + depth[k] * bx, oy + depth[k] * by
        px, py = pose[0] + c * qx - s * qy, pose[1] + s * qx + c * qy
        near = (points[i, 0] - px) ** 2 + (points[i, 1] - py) ** 2
        far = (points[j, 0] - px) ** 2 + (points[j, 1] - py) ** 2
        at, other = (i, j) if near <= far else (j, i)
        if not flags[at] & LINE:
            at = other
        if not flags[at] & LINE:
            continue
        nx = c * lines[at, 0] + s * lines[at, 1]
        ny = c * lines[at, 1] - s * lines[at, 0]
        now = -(nx * bx + ny * by)
        if now <= 0.0:
            continue
        turn = ny * qx - nx * qy
        ux, uy = points[at, 0] - ox, points[at, 1] - oy
        then = (lines[at, 0] * ux + lines[at, 1] * uy) / np.sqrt(ux * ux + uy * uy)
        apart = np.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1])
        shared = apart * now / (depth[k] * step)
        system[0] += nx * nx
        system[1] += nx * ny
        system[2] += nx * turn
        system[3] += ny * ny
        system[4] += ny * turn
        system[5] += turn * turn
        system[SPURIOUS] += lines[at, 3] * ny * ny
        system[SPURIOUS + 1] -= lines[at, 3] * nx * ny
        system[SPURIOUS + 2] += lines[at, 3] * nx * nx
        scale = np.sqrt(now * now + shared * then * then)
        add_outer(gradient, 1.0, scale * nx, scale * ny, scale * turn)
        paired += 1
    return paired


@kernel
def predict(source, rules, poses, informations, pairs):
    """Fill the information (k, 3, 3) of a match from each of `poses` (k, 3), and its pairs (k,).

    No floor and no prior is in it.  `source` holds the fields of `Source`.  `rules` are the noise
    of a range (m), its variance in a match (m^2), the gap ratio that parts two surfaces, and
    the most beams: a scan of more is subsampled, and what remains counts for as many.
    """
    scan = Source(*source)
    noise, variance, gap_ratio, most_beams = rules
    geometry = scan.geometry
    n = len(scan.points)
    stride = max(1, n // most_beams)
    joined = np.empty(n, dtype=np.bool_)
    surfaces(scan.points, scan.flags, geometry, noise, gap_ratio, joined)
    bearings = np.empty((n // stride, 2))
    for k in range(len(bearings)):
        angle = geometry[0] + k * stride * geometry[1]
        bearings[k, 0], bearings[k, 1] = np.cos(angle), np.sin(angle)
    depth, hit = np.empty(len(bearings)), np.empty(len(bearings), dtype=np.int64)
    system, gradient = np.zeros(SYSTEM), np.empty(6)
    for k in range(len(poses)):
        cast(scan.points, joined, geometry, bearings, poses[k], depth, hit)
        pairs[k] = stride * weigh(scan, bearings, poses[k], depth, hit, system, gradient)
        own_information(system, gradient, variance / stride, 0.0, 0.0, informations[k])
