"""Numba kernel that tests whether the heading of a match rests on more than a few pairs."""

from __future__ import annotations

from slam.frontend.compiled import part
from slam.frontend.correspondence_kernels import in_reference
from slam.frontend.degeneracy import (
    HEADING_RIDGE,
    STRONGEST_LIMIT,
    STRONGEST_PAIRS,
    keep_strongest,
)
from slam.frontend.match_arrays import SPURIOUS_TURN


@part
def discount_heading(source, references, pose, scale, work):
    """Fill SPURIOUS_TURN of the sums with what the strongest pairs claim of the heading too much.

    A far pair has a long lever: one, fitted through three points of a bush, can outweigh all
    others and turn the scan by many sigmas.  So no more than a third of the information that is
    kept may rest on the strongest few pairs.  A pair's information is counted with the shift that
    goes with a turn (the heading's Schur complement).
    """
    lines, system, pairs, strongest = references.lines, work.system, work.pairs, work.strongest
    ridge = HEADING_RIDGE * (system[0] + system[3])
    xx, xy, yy = system[0] + ridge, system[1], system[3] + ridge
    det = xx * yy - xy * xy
    if not det > 0.0:
        return
    dx = -(yy * system[2] - xy * system[4]) / det
    dy = -(xx * system[4] - xy * system[2]) / det
    inverse_scale2 = 1.0 / (scale * scale)
    total, alone = 0.0, 0.0
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
            root = 1.0 / (1.0 + r * r * inverse_scale2)
            slope = ax * dx + ay * dy + ay * qx - ax * qy
            information = root * root * slope * slope
            total += information
            keep_strongest(information, strongest)
    for k in range(STRONGEST_PAIRS):
        alone += strongest[k]
    system[SPURIOUS_TURN] = max(alone - STRONGEST_LIMIT * (total - alone), 0.0)
