"""Numba kernel that asks whether the weak axis of a match is seen, or only seems to be."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import inlined, part
from slam.frontend.icp_kernels import FEIGNED, eigen2, in_reference, nearest_beam
from slam.frontend.scan_kernels import LINE, VALID

WEAK = 0.2  # share of the strong axis' information, below which the weak axis has to prove its own
SHIFT = 3.0  # robust scales to either side at which the proof is taken
TRUSTED_SHARE = 0.5  # of its information that the weak axis must show to keep its place
DOUBTED_PAIRS = 3  # single pairs whose word alone does not count
BORNE_OUT = 0.5  # times what all others say: as far they are believed, a third of the whole


@part
def discount_weak_axis(
    source_points,
    source_lines,
    source_flags,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    pose,
    gate,
    scale,
    partners,
    system,
    axis,
    strongest,
):
    """Add to the feigned information in `system` what the weak axis claims and cannot show.

    Returns the share of its claim that the axis keeps; fills `axis` (4,) with the axis as a step
    (x, y, theta) in the source frame, a metre long, and the information (unit noise) left there.
    `strongest` (DOUBTED_PAIRS,) is scratch.

    Held to its pairs, a scan that is shifted along an axis it sees costs more, and it still does
    when each beam may choose its partner anew.  Along a wall whose normals are noisy, or which
    bows, the first holds and the second does not: the next piece of wall serves as well.  So
    the axis keeps the share of its information that the cost with free partners bears out, after
    the strongest few pairs are left out: what they say alone may be a single wrong pair.  Where
    the others prove the axis, the strongest count again, up to a third of the whole.
    """
    turn = max(system[5], 1e-300)
    xx = system[0] - system[2] * system[2] / turn - system[FEIGNED]
    xy = system[1] - system[2] * system[4] / turn - system[FEIGNED + 1]
    yy = system[3] - system[4] * system[4] / turn - system[FEIGNED + 2]
    low, high, angle = eigen2(xx, xy, yy)
    if not 0.0 < low < WEAK * high:
        return 1.0
    x, y = np.cos(angle), np.sin(angle)
    t = -(system[2] * x + system[4] * y) / turn  # the heading that goes with a shift along it
    shift = SHIFT * scale
    held, alone, chance = held_rise(
        source_points,
        lines,
        poses,
        pose,
        partners,
        scale,
        shift * x,
        shift * y,
        shift * t,
        strongest,
    )
    free = 0.0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for side in range(-1, 2):
        ax, ay = side * shift * x, side * shift * y
        cost = free_cost(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose[0] + c * ax - s * ay,
            pose[1] + s * ax + c * ay,
            pose[2] + side * shift * t,
            gate,
            scale,
        )
        free += cost if side != 0 else -2.0 * cost
    share = min(max((free - chance) / max(held, 1e-300), 0.0), 1.0)
    rest = max(low - alone, 0.0)
    left = share * rest
    if left >= TRUSTED_SHARE * low:  # proven without them
        left += share * min(alone, BORNE_OUT * rest)
    surplus = low - left
    system[FEIGNED] += surplus * x * x
    system[FEIGNED + 1] += surplus * x * y
    system[FEIGNED + 2] += surplus * y * y
    axis[0], axis[1], axis[2], axis[3] = x, y, t, left
    return left / low


@part
def free_cost(
    source_points,
    source_lines,
    source_flags,
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
):
    """Robust cost at target_T_source = (x, y, theta) with the partners that are nearest there.

    A beam without partner costs what a far one does, wherever it lies.
    """
    cost, unpaired = 0.0, 0
    gate2, inverse_scale2 = gate * gate, 1.0 / (scale * scale)
    for ref in range(len(poses)):
        first, n = starts[ref], starts[ref + 1] - starts[ref]
        c, s, tx, ty = in_reference(poses, ref, x, y, theta)
        for i in range(len(source_points)):
            if not source_flags[i] & VALID:
                continue
            qx, qy = source_points[i, 0], source_points[i, 1]
            px, py = c * qx - s * qy + tx, s * qx + c * qy + ty
            unpaired += 1
            j, _ = nearest_beam(px, py, points, first, n, geometries, reach2, ref, gate2)
            if j < 0 or not flags[first + j] & LINE:
                continue
            nx, ny = lines[first + j, 0], lines[first + j, 1]
            ax, ay = c * nx + s * ny, c * ny - s * nx
            if source_flags[i] & LINE and ax * source_lines[i, 0] + ay * source_lines[i, 1] < 0.5:
                continue
            residual = nx * px + ny * py - lines[first + j, 2]
            if abs(residual) > gate:
                continue
            unpaired -= 1
            r2 = residual * residual
            cost += r2 / (1.0 + r2 * inverse_scale2)
    return cost + scale * scale * unpaired


@part
def step_back(pose, prior, information, noise, axis):
    """Move `pose` (3,) along `axis` to where the prior, weighed against what is left, puts it."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    dx, dy = pose[0] - prior[0], pose[1] - prior[1]
    e0, e1 = c * dx + s * dy, c * dy - s * dx
    e2 = pose[2] - prior[2]
    e2 -= 2.0 * np.pi * np.floor(e2 / (2.0 * np.pi) + 0.5)
    pull, stiff = 0.0, axis[3] / (noise * noise)
    for k in range(3):
        pull += axis[k] * (information[k, 0] * e0 + information[k, 1] * e1 + information[k, 2] * e2)
        for m in range(3):
            stiff += axis[k] * information[k, m] * axis[m]
    size = -pull / stiff
    pose[0] += size * (c * axis[0] - s * axis[1])
    pose[1] += size * (s * axis[0] + c * axis[1])
    pose[2] += size * axis[2]


@part
def held_rise(source_points, lines, poses, pose, partners, scale, dx, dy, dt, strongest):
    """Second difference of the robust cost over +-(dx, dy, dt) in the source frame, pairs held.

    Also returns the information along that direction that the strongest few pairs hold, and by
    how much the cost may change by chance when every beam draws another residual.
    """
    inverse_scale2 = 1.0 / (scale * scale)
    rise, squares = 0.0, 0.0
    for k in range(DOUBTED_PAIRS):
        strongest[k] = 0.0
    for ref in range(len(poses)):
        c, s, tx, ty = in_reference(poses, ref, pose[0], pose[1], pose[2])
        for i in range(len(source_points)):
            j = partners[ref, i]
            if j < 0:
                continue
            qx, qy = source_points[i, 0], source_points[i, 1]
            nx, ny = lines[j, 0], lines[j, 1]
            ax, ay = c * nx + s * ny, c * ny - s * nx
            r = nx * (c * qx - s * qy + tx) + ny * (s * qx + c * qy + ty) - lines[j, 2]
            slope = ax * dx + ay * dy + (ay * qx - ax * qy) * dt
            before, after = (r - slope) * (r - slope), (r + slope) * (r + slope)
            r2 = r * r
            root = 1.0 / (1.0 + r2 * inverse_scale2)
            rise += before / (1.0 + before * inverse_scale2)
            rise += after / (1.0 + after * inverse_scale2) - 2.0 * r2 * root
            squares += r2 * r2 * root * root
            keep_strongest(root * root * slope * slope, strongest)
    alone = 0.0
    for k in range(DOUBTED_PAIRS):
        alone += strongest[k]
    return rise, alone / (dx * dx + dy * dy), np.sqrt(squares)


@inlined
def keep_strongest(told, strongest):
    """Insert what a pair tells into the descending list (DOUBTED_PAIRS,) if it belongs there."""
    for k in range(DOUBTED_PAIRS):
        if told > strongest[k]:
            told, strongest[k] = strongest[k], told
