"""Numba kernels that follow the range noise through a match: how its gradient scatters."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import kernel, part
from slam.frontend.correspondence_kernels import in_reference
from slam.frontend.scan_kernels import LINE


@part
def add_outer(out, weight, x, y, t):
    """Add the weighted outer product of (x, y, t) to `out` (6): xx, xy, xt, yy, yt, tt."""
    wx, wy = weight * x, weight * y
    out[0] += wx * x
    out[1] += wx * y
    out[2] += wx * t
    out[3] += wy * y
    out[4] += wy * t
    out[5] += weight * t * t


@kernel
def scatter(source, references, pose, pairs, scale, noise, out):
    """Variance of the gradient for unit range noise, `out` (6): xx, xy, xt, yy, yt, tt.

    Taken at `pose` (3,), target_T_source, with the pairs (m, n) and weights of the robust `scale`
    (m); `noise` is one sigma of a range, m.  Returns the residuals' variance over what is expected.

    Noise acts along the beam, so a wall seen at a grazing angle is known better across than
    along the beam.  A beam of the source errs once for all its pairs; a beam of a reference errs
    once for all the lines whose window it belongs to, with its leverage on each (1 / n for the
    line's offset, and its distance from the middle for the line's angle).  Beams that share
    lines are thus correlated as they truly are.
    """
    found, expected = 0.0, 0.0
    inverse_scale2, unit = 1.0 / (scale * scale), 1.0 / (noise * noise)
    points, lines, windows = source.points, references.lines, references.windows
    ox, oy = source.geometry[2], source.geometry[3]
    by_beam = np.zeros((len(points), 3))
    out[:] = 0.0
    for ref in range(len(pairs)):
        # Gradient that each beam of the reference carries: constant, and per m in x and y; each
        # line adds to a run of beams, so the sums are kept as differences.
        runs = np.zeros((references.starts[ref + 1] - references.starts[ref] + 1, 9))
        c, s, tx, ty = in_reference(references.poses, ref, pose[0], pose[1], pose[2])
        for i in range(len(points)):
            j = pairs[ref, i]
            if j < 0:
                continue
            qx, qy = points[i, 0], points[i, 1]
            px, py = c * qx - s * qy + tx, s * qx + c * qy + ty
            nx, ny = lines[j, 0], lines[j, 1]
            ax, ay = c * nx + s * ny, c * ny - s * nx
            r = nx * px + ny * py - lines[j, 2]
            root = 1.0 / (1.0 + r * r * inverse_scale2)
            w = root * root
            gx, gy = w * ax, w * ay
            gt = gy * qx - gx * qy
            by_beam[i, 0] += gx
            by_beam[i, 1] += gy
            by_beam[i, 2] += gt
            a, b = windows[j, 0], windows[j, 1]
            share = 1.0 / (b - a + 1.0)
            ux, uy = qx - ox, qy - oy
            across = ax * ux + ay * uy
            found += w * r * r
            expected += w * (1.0 + share) * across * across / (ux * ux + uy * uy)
            middle = lines[j, 4]
            lever = (nx * py - ny * px - middle) * lines[j, 3] * unit
            constant, along_x, along_y = share - lever * middle, -ny * lever, nx * lever
            add_run(runs, a, b + 1, gx, gy, gt, constant, along_x, along_y)
        sum_runs(runs, references, ref, out)
    for i in range(len(points)):
        gx, gy, gt = by_beam[i, 0], by_beam[i, 1], by_beam[i, 2]
        size2 = gx * gx + gy * gy
        if size2 > 0.0:
            # The gradient points along the normal: its cosine with the beam.
            ux, uy = points[i, 0] - ox, points[i, 1] - oy
            across = gx * ux + gy * uy
            add_outer(out, across * across / (size2 * (ux * ux + uy * uy)), gx, gy, gt)
    return found / max(expected * noise * noise, 1e-300)


@part
def sum_runs(runs, references, ref, out):
    """Add what each beam of reference `ref` carries to `out` (6).

    `runs` (beams + 1, 9) are differences between neighbouring beams.
    """
    points, lines, flags = references.points, references.lines, references.flags
    first = references.starts[ref]
    ox, oy = references.geometries[ref, 2], references.geometries[ref, 3]
    g0 = g1 = g2 = x0 = x1 = x2 = y0 = y1 = y2 = 0.0
    # Sums in plain variables, as in `accumulate`.
    xx, xy, xt, yy, yt, tt = out[0], out[1], out[2], out[3], out[4], out[5]
    for k in range(len(runs) - 1):
        g0, g1, g2 = g0 + runs[k, 0], g1 + runs[k, 1], g2 + runs[k, 2]
        x0, x1, x2 = x0 + runs[k, 3], x1 + runs[k, 4], x2 + runs[k, 5]
        y0, y1, y2 = y0 + runs[k, 6], y1 + runs[k, 7], y2 + runs[k, 8]
        i = first + k
        if not flags[i] & LINE:
            continue
        px, py = points[i, 0], points[i, 1]
        ux, uy = px - ox, py - oy
        across = lines[i, 0] * ux + lines[i, 1] * uy
        weight = across * across / (ux * ux + uy * uy)
        x, y, t = g0 + x0 * px + y0 * py, g1 + x1 * px + y1 * py, g2 + x2 * px + y2 * py
        wx, wy = weight * x, weight * y
        xx, xy, xt = xx + wx * x, xy + wx * y, xt + wx * t
        yy, yt, tt = yy + wy * y, yt + wy * t, tt + weight * t * t
    out[0], out[1], out[2], out[3], out[4], out[5] = xx, xy, xt, yy, yt, tt


@part
def add_run(runs, begin, end, gx, gy, gt, constant, along_x, along_y):
    """Add a gradient times (constant, along_x, along_y) to the beams begin..end - 1."""
    for k in range(3):
        factor = constant if k == 0 else (along_x if k == 1 else along_y)
        x, y, t = gx * factor, gy * factor, gt * factor
        runs[begin, 3 * k] += x
        runs[begin, 3 * k + 1] += y
        runs[begin, 3 * k + 2] += t
        runs[end, 3 * k] -= x
        runs[end, 3 * k + 1] -= y
        runs[end, 3 * k + 2] -= t
