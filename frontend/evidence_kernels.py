"""Numba kernels that test whether the weak direction of a match is seen, or only seems to be."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import part
from slam.frontend.correspondence_kernels import MIN_NORMAL_COSINE, in_reference, nearest_beam
from slam.frontend.degeneracy import (
    PROOF_RATIO,
    PROOF_SHIFT,
    STRONGEST_LIMIT,
    STRONGEST_PAIRS,
    TRUSTED_SHARE,
    keep_strongest,
    taken_by_heading,
    weak_direction,
)
from slam.frontend.match_arrays import SPURIOUS
from slam.frontend.scan_kernels import LINE, VALID


@part
def discount_weak_direction(source, references, pose, level, work):
    """Add to the spurious information of a match what its weak direction claims and cannot show.

    Returns the share of its claim that the direction keeps; fills `work.direction` with a step
    (x, y, theta) of one metre along it in the source frame, and the information (unit noise) left
    there.

    With its pairs held, a scan that is shifted along a direction it sees costs more, and it still
    does when each beam may choose its correspondence anew.  Along a wall whose normals are noisy,
    or which bows, the first holds and the second does not: the next piece of wall serves as well.
    So the direction keeps the share of its information that the cost with free correspondences
    bears out, after the strongest few pairs are left out: what they alone support may be a single
    wrong pair.  Where the others prove the direction, the strongest count again, up to a third of
    the whole.
    """
    system = work.system
    bxx, bxy, byy = taken_by_heading(system[2], system[4], system[5])
    low, high, angle = weak_direction(
        system[0] - bxx - system[SPURIOUS],
        system[1] - bxy - system[SPURIOUS + 1],
        system[3] - byy - system[SPURIOUS + 2],
    )
    if not 0.0 < low < PROOF_RATIO * high:
        return 1.0
    x, y = np.cos(angle), np.sin(angle)
    turn = max(system[5], 1e-300)
    t = -(system[2] * x + system[4] * y) / turn  # the heading that goes with a shift along it
    direction = work.direction
    direction[0], direction[1], direction[2] = x, y, t
    shift = PROOF_SHIFT * level.scale
    held, alone, chance = held_rise(source, references, pose, level.scale, shift, work)
    free = 0.0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for side in range(-1, 2):
        ax, ay = side * shift * x, side * shift * y
        cost = free_cost(
            source,
            references,
            pose[0] + c * ax - s * ay,
            pose[1] + s * ax + c * ay,
            pose[2] + side * shift * t,
            level,
        )
        free += cost if side != 0 else -2.0 * cost
    share = min(max((free - chance) / max(held, 1e-300), 0.0), 1.0)
    rest = max(low - alone, 0.0)
    left = share * rest
    if left >= TRUSTED_SHARE * low:  # proven without them
        left += share * min(alone, STRONGEST_LIMIT * rest)
    surplus = low - left
    system[SPURIOUS] += surplus * x * x
    system[SPURIOUS + 1] += surplus * x * y
    system[SPURIOUS + 2] += surplus * y * y
    direction[3] = left
    return left / low


@part
def free_cost(source, references, x, y, theta, level):
    """Robust cost at target_T_source = (x, y, theta), each beam paired with what is nearest there.

    A beam without correspondence costs what a far one does, wherever it lies.
    """
    cost, unpaired = 0.0, 0
    lines, gate, scale = references.lines, level.gate, level.scale
    gate2, inverse_scale2 = gate * gate, 1.0 / (scale * scale)
    for ref in range(len(references.poses)):
        first = references.starts[ref]
        c, s, tx, ty = in_reference(references.poses, ref, x, y, theta)
        for i in range(len(source.points)):
            if not source.flags[i] & VALID:
                continue
            qx, qy = source.points[i, 0], source.points[i, 1]
            px, py = c * qx - s * qy + tx, s * qx + c * qy + ty
            unpaired += 1
            j, _ = nearest_beam(px, py, references, ref, gate2)
            if j < 0 or not references.flags[first + j] & LINE:
                continue
            nx, ny = lines[first + j, 0], lines[first + j, 1]
            ax, ay = c * nx + s * ny, c * ny - s * nx
            cosine = ax * source.lines[i, 0] + ay * source.lines[i, 1]
            if source.flags[i] & LINE and cosine < MIN_NORMAL_COSINE:
                continue
            residual = nx * px + ny * py - lines[first + j, 2]
            if abs(residual) > gate:
                continue
            unpaired -= 1
            r2 = residual * residual
            cost += r2 / (1.0 + r2 * inverse_scale2)
    return cost + scale * scale * unpaired


@part
def step_back(pose, prior, noise, direction):
    """Move `pose` (3,) along `direction` (4,) to where the prior, weighed against it, puts it."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    centre, information = prior.pose, prior.information
    dx, dy = pose[0] - centre[0], pose[1] - centre[1]
    e0, e1 = c * dx + s * dy, c * dy - s * dx
    e2 = pose[2] - centre[2]
    e2 -= 2.0 * np.pi * np.floor(e2 / (2.0 * np.pi) + 0.5)
    pull, stiff = 0.0, direction[3] / (noise * noise)
    for k in range(3):
        pull += direction[k] * (
            information[k, 0] * e0 + information[k, 1] * e1 + information[k, 2] * e2
        )
        for m in range(3):
            stiff += direction[k] * information[k, m] * direction[m]
    size = -pull / stiff
    pose[0] += size * (c * direction[0] - s * direction[1])
    pose[1] += size * (s * direction[0] + c * direction[1])
    pose[2] += size * direction[2]


@part
def held_rise(source, references, pose, scale, shift, work):
    """Second difference of the robust cost over +-shift (m) along the direction, pairs held.

    Also returns the information along it that the strongest few pairs hold, and by how much the
    cost may change by chance when every beam draws another residual.
    """
    lines, pairs, strongest = references.lines, work.pairs, work.strongest
    dx, dy, dt = shift * work.direction[0], shift * work.direction[1], shift * work.direction[2]
    inverse_scale2 = 1.0 / (scale * scale)
    rise, squares = 0.0, 0.0
    for k in range(STRONGEST_PAIRS):
        strongest[k] = 0.0
    for ref in range(len(references.poses)):
        c, s, tx, ty = in_reference(references.poses, ref, pose[0], pose[1], pose[2])
        for i in range(len(source.points)):
            j = pairs[ref, i]
            if j < 0:
                continue
            qx, qy = source.points[i, 0], source.points[i, 1]
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
    for k in range(STRONGEST_PAIRS):
        alone += strongest[k]
    return rise, alone / (dx * dx + dy * dy), np.sqrt(squares)
