"""Polar scan matching (Diosi and Kleeman 2005): ranges compared bearing by bearing."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import allocating_part, kernel, part
from slam.frontend.scan_kernels import VALID

MAX_ERROR = 1.0  # m, range differences beyond are other objects (PM_MAX_ERROR)
SOFTNESS = 0.7  # m, C of the weight C^2 / (d^2 + C^2)
SEARCH = 0.35  # rad, half width of the orientation search
LARGEST_GAP = 0.35  # m between neighbours that belong to one surface


@part
def project(source_points, source_flags, geometry, n, pose, ranges):
    """Ranges (n,) of the source as seen from the reference, at its bearings; nan where unseen.

    Neighbouring points of one surface are joined by straight pieces; of surfaces behind each
    other the nearer one counts, and surfaces seen from behind do not.
    """
    for k in range(n):
        ranges[k] = np.nan
    angle_min, step = geometry[0], geometry[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    last_r, last_k = -1.0, 0.0
    last_x, last_y = 0.0, 0.0
    for i in range(len(source_points)):
        if not source_flags[i] & VALID:
            last_r = -1.0
            continue
        qx, qy = source_points[i, 0], source_points[i, 1]
        x = c * qx - s * qy + pose[0] - geometry[2]
        y = s * qx + c * qy + pose[1] - geometry[3]
        r = np.sqrt(x * x + y * y)
        turn = np.arctan2(y, x) - angle_min
        turn -= 2.0 * np.pi * np.floor(turn / (2.0 * np.pi))
        k = turn / step
        if last_r >= 0.0 and np.hypot(x - last_x, y - last_y) < max(LARGEST_GAP, 10.0 * step * r):
            if last_k < k < last_k + 0.25 * n:
                for j in range(int(np.ceil(last_k)), int(np.floor(k)) + 1):
                    if 0 <= j < n:
                        share = (j - last_k) / (k - last_k)
                        value = last_r + share * (r - last_r)
                        if np.isnan(ranges[j]) or value < ranges[j]:
                            ranges[j] = value
        last_r, last_k, last_x, last_y = r, k, x, y


@allocating_part
def _turn(reference, ranges, step):
    """The turn (rad) that makes the ranges agree best, by a search and a parabola (section 2.3)."""
    n = len(reference)
    most = min(int(np.ceil(SEARCH / step)), n - 1)  # beyond, no beam has a counterpart
    errors = np.empty(2 * most + 1)
    for shift in range(-most, most + 1):
        total, count = 0.0, 0
        for k in range(max(0, -shift), min(n, n - shift)):
            difference = abs(ranges[k] - reference[k + shift])
            if not np.isnan(difference):
                total += min(difference, MAX_ERROR)
                count += 1
        errors[shift + most] = total / count if count > 0.3 * n else np.inf
    best = 0
    for k in range(1, len(errors)):
        if errors[k] < errors[best]:
            best = k
    if not np.isfinite(errors[best]):
        return 0.0
    offset = 0.0
    if 0 < best < 2 * most:
        left, right = errors[best - 1], errors[best + 1]
        bend = left - 2.0 * errors[best] + right
        if np.isfinite(bend) and bend > 0.0:
            offset = 0.5 * (left - right) / bend
    return (best - most + offset) * step


@kernel
def psm(source_points, source_flags, reference, geometry, pose, iterations, tolerance):
    """Move `pose` (3,) of the source in the reference's frame; (last step in m, iterations).

    Turns and shifts alternate: the turn by comparing whole profiles, the shift by weighted least
    squares on the range differences, whose derivative is the unit vector of the bearing.
    """
    n = len(reference)
    ranges = np.empty(n)
    size = np.inf
    for iteration in range(iterations):
        project(source_points, source_flags, geometry, n, pose, ranges)
        if iteration % 3 == 0:
            turn = _turn(reference, ranges, geometry[1])
            c, s = np.cos(turn), np.sin(turn)
            x, y = pose[0] - geometry[2], pose[1] - geometry[3]
            pose[0], pose[1] = c * x - s * y + geometry[2], s * x + c * y + geometry[3]
            pose[2] += turn
            size = abs(turn)
            continue
        xx, xy, yy, gx, gy = 1e-9, 0.0, 1e-9, 0.0, 0.0
        count = 0
        for k in range(n):
            difference = reference[k] - ranges[k]
            if np.isnan(difference) or abs(difference) > MAX_ERROR:
                continue
            w = SOFTNESS**2 / (difference * difference + SOFTNESS**2)
            bearing = geometry[0] + k * geometry[1]
            ux, uy = np.cos(bearing), np.sin(bearing)
            # The slope of the wall: a shift across the beam changes the range as well.
            if 0 < k < n - 1:
                slope = (reference[k + 1] - reference[k - 1]) / (2.0 * geometry[1])
                if abs(slope) < 10.0 * reference[k]:
                    ux, uy = ux + slope / reference[k] * uy, uy - slope / reference[k] * ux
            xx += w * ux * ux
            xy += w * ux * uy
            yy += w * uy * uy
            gx += w * ux * difference
            gy += w * uy * difference
            count += 1
        det = xx * yy - xy * xy
        if count < 10 or det <= 1e-9 * (xx + yy) ** 2:
            return np.inf, iteration + 1
        dx, dy = (yy * gx - xy * gy) / det, (xx * gy - xy * gx) / det
        shorten = min(1.0, 0.3 / max(np.hypot(dx, dy), 1e-12))
        pose[0] += shorten * dx
        pose[1] += shorten * dy
        size = max(size if iteration % 3 == 1 else 0.0, abs(dx) + abs(dy))
        if iteration % 3 == 2 and size < tolerance:
            return size, iteration + 1
    return size, iterations
