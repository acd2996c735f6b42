"""Numba kernels that find the nearest point of a reference scan by a search in bearing."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import inlined, part
from slam.frontend.scan_kernels import VALID

FARTHEST_BEAM = 1e9  # an integer of 32 bits holds no more; no laser has as many
UNTESTED_STEPS = 2  # beams to either side that are taken before the search asks whether to end
# Least cosine between the normals of a pair, 60 degrees apart.  A wall's two faces (-1) and
# the two walls of a corner (0) must not pair; the normals of short windows in clutter err by tens
# of degrees and still may.
MIN_NORMAL_COSINE = 0.5


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
def nearest_from(px, py, centre, references, ref, gate2):
    """Beam of reference `ref` whose point is nearest to (px, py), and its squared distance.

    Searches outwards in bearing from the beam `centre` that looks at (px, py).  A point seen k
    beams away is at least r sin((k - 1/2) step) far, less the error of `bearing_of`, which ends
    the search; `References.reach2` holds sin^2 of those angles up to 90 degrees.  The search goes
    round the whole circle, also where it has no beams: what lies outside the field of view may be
    nearest to either end of it.

    (-1, gate2) if no point is nearer than the gate; beams without a point hold nan and are never
    near.  Rows are indexed here, not sliced by the caller: one slice costs more than the search.
    """
    points, geometries, reach2 = references.points, references.geometries, references.reach2
    first = references.starts[ref]
    n = references.starts[ref + 1] - first
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
        # Nearly all searches end where there are beams on both sides, and after a step or two:
        # those are taken untested.  No branches on distances: the processor cannot predict them.
        inner = min(min(centre, n - 1 - centre), min(last, farthest))
        at = first + centre
        while k <= inner and (k <= UNTESTED_STEPS or r2 * reach2[row, k] <= best2):
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


@inlined
def nearest_beam(px, py, references, ref, gate2):
    """As `nearest_from`, from the beam that looks at (px, py)."""
    geometries = references.geometries
    vx, vy = px - geometries[ref, 2], py - geometries[ref, 3]
    angle_min, step, whole = geometries[ref, 0], geometries[ref, 1], int(geometries[ref, 4])
    centre = beam_towards(vx, vy, angle_min, step, whole)
    return nearest_from(px, py, centre, references, ref, gate2)


@inlined
def in_reference(poses, ref, x, y, theta):
    """reference_T_source as (cos, sin, x, y), from target_T_source = (x, y, theta)."""
    c, s = np.cos(theta - poses[ref, 2]), np.sin(theta - poses[ref, 2])
    cr, sr = np.cos(poses[ref, 2]), np.sin(poses[ref, 2])
    dx, dy = x - poses[ref, 0], y - poses[ref, 1]
    return c, s, cr * dx + sr * dy, cr * dy - sr * dx


@part
def seed_search(source, stride, references, transforms, pairs):
    """Fill `pairs` with the beam that looks at each point; -1 for beams without a point.

    A loop of its own: how long a search takes depends on the data, and would hold this up.
    """
    geometries = references.geometries
    for ref in range(len(transforms)):
        c, s, tx, ty = (
            transforms[ref, 0],
            transforms[ref, 1],
            transforms[ref, 2] - geometries[ref, 2],
            transforms[ref, 3] - geometries[ref, 3],
        )
        angle_min, step, whole = geometries[ref, 0], geometries[ref, 1], int(geometries[ref, 4])
        for i in range(0, len(source.points), stride):
            qx, qy = source.points[i, 0], source.points[i, 1]
            vx, vy = c * qx - s * qy + tx, s * qx + c * qy + ty
            beam = beam_towards(vx, vy, angle_min, step, whole)
            pairs[ref, i] = beam if source.flags[i] & VALID else -1
