"""Point-to-point ICP, as the seed paper uses it (Besl and McKay 1992)."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import bare_kernel
from slam.frontend.correspondence_kernels import nearest_beam
from slam.frontend.match_arrays import References
from slam.frontend.scan_kernels import VALID


@bare_kernel
def point_to_point(points, flags, references, pose, gate, iterations, tolerance):
    """Move `pose` (3,) until nearest points agree best; returns (last step in m, iterations).

    `points` (n, 2) and `flags` (n,) are the source's, `references` the fields of `References`.
    Every point of the source is paired with the nearest point of each reference within `gate`
    (m); rotation and translation follow in closed form.  No weights and no second gate: what the
    paper describes, with its pull towards zero motion where scans are discrete.
    """
    stack = References(*references)
    poses = stack.poses
    size = np.inf
    for iteration in range(iterations):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        count, sx, sy, tx, ty = 0, 0.0, 0.0, 0.0, 0.0
        dot, cross = 0.0, 0.0
        for ref in range(len(poses)):
            cr, sr = np.cos(poses[ref, 2]), np.sin(poses[ref, 2])
            first = stack.starts[ref]
            for i in range(len(points)):
                if not flags[i] & VALID:
                    continue
                # The point in the target frame, and in that of the reference.
                px = c * points[i, 0] - s * points[i, 1] + pose[0]
                py = s * points[i, 0] + c * points[i, 1] + pose[1]
                dx, dy = px - poses[ref, 0], py - poses[ref, 1]
                u, v = cr * dx + sr * dy, cr * dy - sr * dx
                j, _ = nearest_beam(u, v, stack, ref, gate * gate)
                if j < 0:
                    continue
                nx, ny = stack.points[first + j, 0], stack.points[first + j, 1]
                qx = cr * nx - sr * ny + poses[ref, 0]
                qy = sr * nx + cr * ny + poses[ref, 1]
                count += 1
                sx, sy, tx, ty = sx + px, sy + py, tx + qx, ty + qy
                dot += px * qx + py * qy
                cross += px * qy - py * qx
        if count < 3:
            return np.inf, iteration + 1
        mx, my, ox, oy = sx / count, sy / count, tx / count, ty / count
        turn = np.arctan2(cross - count * (mx * oy - my * ox), dot - count * (mx * ox + my * oy))
        ct, st = np.cos(turn), np.sin(turn)
        x = ct * (pose[0] - mx) - st * (pose[1] - my) + ox
        y = st * (pose[0] - mx) + ct * (pose[1] - my) + oy
        size = max(abs(x - pose[0]) + abs(y - pose[1]), 5.0 * abs(turn))
        pose[0], pose[1], pose[2] = x, y, pose[2] + turn
        if size < tolerance:
            return size, iteration + 1
    return size, iterations
