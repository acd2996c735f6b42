"""Numba kernel that counts what of a scan fits other scans at a pose, in independent pieces."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import inlined, kernel
from slam.frontend.correspondence_kernels import beam_towards, in_reference, nearest_beam
from slam.frontend.match_arrays import References, Source
from slam.frontend.scan_kernels import LINE, VALID

# A piece of surface whose errors are its own: wider than a person or a post, so that one moving
# thing is one witness however many beams it fills, and wider than what neighbouring beams share.
PIECE_RAD = np.deg2rad(5.0)
PIECE_M = 0.5

FITS, UNSEEN, CONTRADICTS = 0, 1, 2


@kernel
def count_pieces(source, references, pose, gate, scale):
    """Count the pieces of a scan that fit the references at a pose, and those that do not.

    A beam fits if it ends on a line of any reference, to within `scale`, or, where there is no
    line, as near to a point as its neighbours would.  It contradicts if it ends more than `gate`
    before what a reference saw in that direction, or beyond it where the scan looks through what
    that reference saw; the rest ends where none has looked.  The beams of one piece share its vote.

    Args:
        source: the fields of `Source`.
        references: the fields of `References`.
        pose: (x, y, theta), target_T_source.
        gate: m, farther points are not the same.
        scale: m, residual of a beam that fits.

    Returns:
        Pieces that fit, that are new, and that contradict; together all pieces of the scan.
    """
    scan, stack = Source(*source), References(*references)
    x, y, theta = pose
    votes = np.zeros(3)
    here = np.zeros(3)
    begun = False
    first_x = first_y = first_angle = 0.0
    laser_x, laser_y = scan.geometry[2], scan.geometry[3]
    for i in range(len(scan.points)):
        if not scan.flags[i] & VALID:
            continue
        qx, qy = scan.points[i, 0], scan.points[i, 1]
        angle = scan.geometry[0] + i * scan.geometry[1]
        if begun:
            dx, dy = qx - first_x, qy - first_y
            if angle - first_angle >= PIECE_RAD and dx * dx + dy * dy >= PIECE_M * PIECE_M:
                add_votes(here, votes)
                begun = False
        if not begun:
            begun, first_x, first_y, first_angle = True, qx, qy, angle
        spacing = scan.geometry[1] * np.hypot(qx - laser_x, qy - laser_y)
        here[beam_says(scan, i, stack, x, y, theta, gate, scale, spacing)] += 1.0
    if begun:
        add_votes(here, votes)
    return votes[0], votes[1], votes[2]


@inlined
def add_votes(here, votes):
    """Share one piece's vote among its beams, and begin the next."""
    total = here[0] + here[1] + here[2]
    for k in range(3):
        votes[k] += here[k] / total
        here[k] = 0.0


@inlined
def beam_says(scan, i, stack, x, y, theta, gate, scale, spacing):
    """FITS, UNSEEN or CONTRADICTS."""
    qx, qy = scan.points[i, 0], scan.points[i, 1]
    says = UNSEEN
    near, far = max(scale, spacing), max(gate, spacing)
    for ref in range(len(stack.poses)):
        c, s, tx, ty = in_reference(stack.poses, ref, x, y, theta)
        px, py = c * qx - s * qy + tx, s * qx + c * qy + ty
        first = stack.starts[ref]
        j, distance2 = nearest_beam(px, py, stack, ref, far * far)
        if j >= 0:
            j += first
            if stack.flags[j] & LINE:
                residual = stack.lines[j, 0] * px + stack.lines[j, 1] * py - stack.lines[j, 2]
                if abs(residual) < scale:
                    return FITS
            elif distance2 < near * near:
                return FITS
        seen_x, seen_y = seen_towards(stack, ref, px, py)
        if not np.isfinite(seen_x):
            continue
        vx, vy = px - stack.geometries[ref, 2], py - stack.geometries[ref, 3]
        wx, wy = seen_x - stack.geometries[ref, 2], seen_y - stack.geometries[ref, 3]
        beyond = np.hypot(vx, vy) - np.hypot(wx, wy)
        through = beyond > gate and looks_through(scan, (c, s, tx, ty), seen_x, seen_y, gate)
        if beyond < -gate or through:
            says = CONTRADICTS
    return says


@inlined
def seen_towards(stack, ref, px, py):
    """What reference `ref` sees in the direction of (px, py), in its own frame; nan if nothing."""
    first = stack.starts[ref]
    laser_x, laser_y = stack.geometries[ref, 2], stack.geometries[ref, 3]
    angle_min, step = stack.geometries[ref, 0], stack.geometries[ref, 1]
    whole = int(stack.geometries[ref, 4])
    beam = beam_towards(px - laser_x, py - laser_y, angle_min, step, whole)
    if beam >= stack.starts[ref + 1] - first:
        return np.nan, np.nan
    return stack.points[first + beam, 0], stack.points[first + beam, 1]


@inlined
def looks_through(scan, at, x, y, gate):
    """Whether the scan, `at` (cos, sin, x, y) in a reference, sees beyond its point (x, y)."""
    c, s, tx, ty = at
    dx, dy = x - tx, y - ty
    qx, qy = c * dx + s * dy - scan.geometry[2], c * dy - s * dx - scan.geometry[3]
    beam = beam_towards(qx, qy, scan.geometry[0], scan.geometry[1], int(scan.geometry[4]))
    if beam >= len(scan.points) or not scan.flags[beam] & VALID:
        return False
    rx, ry = scan.points[beam, 0] - scan.geometry[2], scan.points[beam, 1] - scan.geometry[3]
    return np.hypot(rx, ry) > np.hypot(qx, qy) + gate
