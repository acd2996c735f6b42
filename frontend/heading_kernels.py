"""Numba kernel that asks whether the heading of a match rests on more than a few pairs."""

from __future__ import annotations

from slam.frontend.compiled import part
from slam.frontend.evidence_kernels import BORNE_OUT, DOUBTED_PAIRS, keep_strongest
from slam.frontend.icp_kernels import FEIGNED_TURN, in_reference

RIDGE = 1e-3  # share of the translation's information that bounds the shift along a blind axis


@part
def doubt_heading(source_points, lines, poses, pose, partners, scale, system, strongest):
    """Fill FEIGNED_TURN of `system` with what the strongest pairs tell of the heading too loudly.

    A far pair has a long lever: one, fitted through three points of a bush, can outweigh all
    others and turn the scan by many sigmas.  So no more than a third of what is believed may rest
    on the strongest few pairs.  What a pair tells is counted with the shift that goes with a turn
    (the heading's Schur complement).  `strongest` (DOUBTED_PAIRS,) is scratch.
    """
    ridge = RIDGE * (system[0] + system[3])
    xx, xy, yy = system[0] + ridge, system[1], system[3] + ridge
    det = xx * yy - xy * xy
    if not det > 0.0:
        return
    dx = -(yy * system[2] - xy * system[4]) / det
    dy = -(xx * system[4] - xy * system[2]) / det
    inverse_scale2 = 1.0 / (scale * scale)
    total, alone = 0.0, 0.0
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
            root = 1.0 / (1.0 + r * r * inverse_scale2)
            slope = ax * dx + ay * dy + ay * qx - ax * qy
            told = root * root * slope * slope
            total += told
            keep_strongest(told, strongest)
    for k in range(DOUBTED_PAIRS):
        alone += strongest[k]
    system[FEIGNED_TURN] = max(alone - BORNE_OUT * (total - alone), 0.0)
