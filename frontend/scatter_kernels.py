"""Numba kernels that follow the range noise through a match: how its gradient scatters."""

from __future__ import annotations

import numpy as np
from numba import njit

from frontend.scan_kernels import LINE, VALID


@njit(cache=True, nogil=True)
def add_outer(out, x, y, t):
    """Add the outer product of (x, y, t) to `out` (6): xx, xy, xt, yy, yt, tt."""
    out[0] += x * x
    out[1] += x * y
    out[2] += x * t
    out[3] += y * y
    out[4] += y * t
    out[5] += t * t


@njit(cache=True, nogil=True)
def scatter(
    source_points,
    source_flags,
    source_geometry,
    points,
    lines,
    windows,
    flags,
    starts,
    geometries,
    noise,
    poses,
    pose,
    partners,
    scale,
    out,
):
    """Variance of the gradient for unit range noise, `out` (6): xx, xy, xt, yy, yt, tt.

    Noise acts along the beam, so a wall seen at a grazing angle is known better across than
    along the beam.  A beam of the source errs once for all its pairs; a beam of a reference errs
    once for all the lines whose window it belongs to, with its leverage on each (1 / n for the
    line's offset, and its distance from the middle for the line's angle).  Beams that share
    lines are thus correlated as they truly are.
    """
    out[:] = 0.0
    found, expected = 0.0, 0.0
    inverse_scale2 = 1.0 / (scale * scale)
    by_beam = np.zeros((len(source_points), 3))
    for ref in range(len(partners)):
        first, n = starts[ref], starts[ref + 1] - starts[ref]
        # Gradient that each beam of the reference carries: constant, and per m in x and y; each
        # line adds to a run of beams, so the sums are kept as differences.
        runs = np.zeros((n + 1, 9))
        c, s = np.cos(pose[2] - poses[ref, 2]), np.sin(pose[2] - poses[ref, 2])
        cr, sr = np.cos(poses[ref, 2]), np.sin(poses[ref, 2])
        dx, dy = pose[0] - poses[ref, 0], pose[1] - poses[ref, 1]
        tx, ty = cr * dx + sr * dy, cr * dy - sr * dx
        for i in range(len(source_points)):
            j = partners[ref, i]
            if j < 0 or not source_flags[i] & VALID:
                continue
            qx, qy = source_points[i, 0], source_points[i, 1]
            px, py = c * qx - s * qy + tx, s * qx + c * qy + ty
            nx, ny = lines[j, 0], lines[j, 1]
            residual = nx * px + ny * py - lines[j, 2]
            root = 1.0 / (1.0 + residual * residual * inverse_scale2)
            w = root * root
            gx, gy = w * (c * nx + s * ny), w * (c * ny - s * nx)
            gt = gy * qx - gx * qy
            by_beam[i, 0] += gx
            by_beam[i, 1] += gy
            by_beam[i, 2] += gt
            ux, uy = qx - source_geometry[2], qy - source_geometry[3]
            cosine2 = (gx * ux + gy * uy) ** 2 / (w * w * (ux * ux + uy * uy))
            found += w * residual * residual
            expected += (
                w * noise * noise * cosine2 * (1.0 + 1.0 / (windows[j, 1] - windows[j, 0] + 1.0))
            )
            middle = lines[j, 4]
            lever = (nx * py - ny * px - middle) * lines[j, 3] / (noise * noise)
            a, b = windows[j, 0], windows[j, 1]
            constant = 1.0 / (b - a + 1.0) - lever * middle
            add_run(runs, a, b + 1, gx, gy, gt, constant, -ny * lever, nx * lever)
        for k in range(1, n):
            for m in range(9):
                runs[k, m] += runs[k - 1, m]
        for k in range(n):
            t = first + k
            if not flags[t] & LINE:
                continue
            x, y = points[t, 0], points[t, 1]
            ux, uy = x - geometries[ref, 2], y - geometries[ref, 3]
            cosine = abs(lines[t, 0] * ux + lines[t, 1] * uy) / np.sqrt(ux * ux + uy * uy)
            add_outer(
                out,
                cosine * (runs[k, 0] + runs[k, 3] * x + runs[k, 6] * y),
                cosine * (runs[k, 1] + runs[k, 4] * x + runs[k, 7] * y),
                cosine * (runs[k, 2] + runs[k, 5] * x + runs[k, 8] * y),
            )
    for i in range(len(source_points)):
        gx, gy, gt = by_beam[i, 0], by_beam[i, 1], by_beam[i, 2]
        size = np.sqrt(gx * gx + gy * gy)
        if size > 0.0:
            ux, uy = (
                source_points[i, 0] - source_geometry[2],
                source_points[i, 1] - source_geometry[3],
            )
            # The gradient points along the normal: its cosine with the beam.
            cosine = abs(gx * ux + gy * uy) / (size * np.sqrt(ux * ux + uy * uy))
            add_outer(out, cosine * gx, cosine * gy, cosine * gt)
    return found / max(expected, 1e-300)


@njit(cache=True, nogil=True)
def add_run(runs, begin, end, gx, gy, gt, constant, along_x, along_y):
    """Add a gradient times (constant, along_x, along_y) to the beams begin..end - 1."""
    for part in range(3):
        factor = constant if part == 0 else (along_x if part == 1 else along_y)
        runs[begin, 3 * part] += gx * factor
        runs[begin, 3 * part + 1] += gy * factor
        runs[begin, 3 * part + 2] += gt * factor
        runs[end, 3 * part] -= gx * factor
        runs[end, 3 * part + 1] -= gy * factor
        runs[end, 3 * part + 2] -= gt * factor
