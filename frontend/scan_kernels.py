"""Numba kernels of scan preparation: placing points, fitting the longest straight windows."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import inlined, kernel, merged, part

HALF_WIDTHS = np.array([1, 2, 3, 5, 8, 12, 18, 27, 40, 60], dtype=np.int64)
# Squared residuals of a line through k + 2 points, in units of the noise's variance, that noise
# alone explains: k of them are expected, and three sigmas more are allowed.
_FREE = np.arange(2 * HALF_WIDTHS[-1] + 1)
ALLOWED = _FREE + 3.0 * np.sqrt(2.0 * _FREE)
ONE_SIDED = 6  # of the half widths, those that a window to one side only may have
SHARES = 1.0 / np.maximum(np.arange(len(ALLOWED) + 1), 1)  # of a point among as many: no division
CENTRE_RANGE = 10.0  # m, farther points do not move a scan's centre

VALID = 1  # the beam hit something
LINE = 2  # and a line could be fitted there


@kernel
def read_scan(ranges, laser, limits, fit):
    """All arrays of a prepared scan from its ranges (n,); lengths in m, angles in rad.

    Args:
        ranges: (n,) m.
        laser: first bearing and step in the base frame, the laser's x and y, and how many beams a
            whole turn has.
        limits: nearest and farthest range that is used.
        fit: one sigma of a range, sigmas that count as noise, gap ratio and largest sigma of a
            normal, see `ScanConfig`.

    Returns:
        Points (n, 2), lines (n, 5), windows (n, 2), flags (n,), geometries (1, 5), centre (2,),
        starts (2,) and how many beams are valid.
    """
    angle_min, step, laser_x, laser_y, whole = laser
    nearest, farthest = limits
    noise, tolerance, gap_ratio, sigma_max = fit
    n = len(ranges)
    points, lines = np.empty((n, 2)), np.empty((n, 5))
    windows, flags = np.empty((n, 2), dtype=np.int32), np.empty(n, dtype=np.uint8)
    geometries, centre = np.empty((1, 5)), np.empty(2)
    geometry = geometries[0]
    geometry[0], geometry[1] = angle_min, step
    geometry[2], geometry[3], geometry[4] = laser_x, laser_y, whole
    starts = np.empty(2, dtype=np.int64)
    starts[0], starts[1] = 0, n
    valid = place_points(ranges, geometry, nearest, farthest, points, flags, centre)
    fit_lines(points, flags, geometry, noise, tolerance, gap_ratio, sigma_max, lines, windows)
    return points, lines, windows, flags, geometries, centre, starts, valid


@part
def place_points(ranges, geometry, nearest, farthest, points, flags, centre):
    """Fill points (n, 2), flags (n,) and centre (2,); return how many beams are valid."""
    angle_min, step, ox, oy = geometry[0], geometry[1], geometry[2], geometry[3]
    c, s = np.cos(angle_min), np.sin(angle_min)
    dc, ds = np.cos(step), np.sin(step)
    valid, near = 0, 0
    sum_x, sum_y = 0.0, 0.0
    for i in range(len(ranges)):
        r = float(ranges[i])
        if r >= nearest and r < farthest:  # false for nan and inf
            points[i, 0] = ox + r * c
            points[i, 1] = oy + r * s
            flags[i] = VALID
            valid += 1
            if r < CENTRE_RANGE:
                near += 1
                sum_x += points[i, 0]
                sum_y += points[i, 1]
        else:
            points[i, 0] = np.nan
            points[i, 1] = np.nan
            flags[i] = 0
        c, s = c * dc - s * ds, s * dc + c * ds
    centre[0] = sum_x / near if near else ox
    centre[1] = sum_y / near if near else oy
    return valid


@inlined
def _fit(sums, i, j):
    """Centroid of points i..j and their scatter about it: mx, my, xx, yy, xy."""
    share = SHARES[np.uintp(j - i + 1)]  # unsigned: signed indices are asked if they count back
    a, b = np.uintp(i), np.uintp(j + 1)
    x, y = sums[b, 0] - sums[a, 0], sums[b, 1] - sums[a, 1]
    mx, my = x * share, y * share
    xx = (sums[b, 2] - sums[a, 2]) - x * mx
    yy = (sums[b, 3] - sums[a, 3]) - y * my
    xy = (sums[b, 4] - sums[a, 4]) - x * my
    return mx, my, xx, yy, xy


@inlined
def _normal(xx, yy, xy):
    """A vector across the line whose scatter matrix is [[xx, xy], [xy, yy]], of any length."""
    half = 0.5 * (xx - yy)
    longer = abs(half) + np.sqrt(half * half + xy * xy)
    # Of the two rows of (scatter - larger eigenvalue), the longer one is the more exact.
    return (-xy, longer) if half >= 0.0 else (longer, -xy)


@merged
def fit_lines(points, flags, geometry, noise, tolerance, gap_ratio, sigma_max, lines, windows):
    """Fit to every valid beam the longest straight window around it; fills lines and windows.

    Least squares on prefix sums, so that a window of any length costs the same.  Three plain
    loops, not one: compiled together they take half as long again.
    """
    n = len(points)
    sums = np.empty((n + 1, 5))
    first = np.empty(n, dtype=np.int64)  # of the unbroken surface that beam i lies on
    last = np.empty(n, dtype=np.int64)
    _add_up(points, flags, geometry, noise, gap_ratio, sums, first, last)
    limit = (tolerance * noise) ** 2  # variance that counts as noise
    _find_windows(sums, flags, first, last, limit, windows)
    _fit_windows(sums, windows, geometry, noise, sigma_max, lines, flags)


@part
def _add_up(points, flags, geometry, noise, gap_ratio, sums, first, last):
    """Fill the prefix sums (n + 1, 5), about the laser, and each beam's surface (n,), (n,)."""
    n = len(points)
    step, ox, oy = geometry[1], geometry[2], geometry[3]
    spread2 = (gap_ratio * step) ** 2  # of the widest gap to the range
    least2 = (5.0 * noise) ** 2
    u, v = 0.0, 0.0
    sums[0] = 0.0
    for i in range(n):
        x, y = 0.0, 0.0
        if flags[i] & VALID:
            x, y = points[i, 0] - ox, points[i, 1] - oy
        sums[i + 1, 0] = sums[i, 0] + x
        sums[i + 1, 1] = sums[i, 1] + y
        sums[i + 1, 2] = sums[i, 2] + x * x
        sums[i + 1, 3] = sums[i, 3] + y * y
        sums[i + 1, 4] = sums[i, 4] + x * y
        first[i] = i
        if i > 0 and (flags[i] & VALID) and (flags[i - 1] & VALID):
            dx, dy = x - u, y - v
            r2 = min(x * x + y * y, u * u + v * v)
            if dx * dx + dy * dy <= max(spread2 * r2, least2):
                first[i] = first[i - 1]
        u, v = x, y
    for i in range(n - 1, -1, -1):
        last[i] = last[i + 1] if i + 1 < n and first[i + 1] == first[i] else i


@part
def _find_windows(sums, flags, first, last, limit, windows):
    """Fill the first and last beam of each beam's window; equal where there is none."""
    w = np.int64(2)  # a plain 2 would be a type of its own, and the search compile twice
    for i in range(len(flags)):
        a, b = i, i
        if flags[i] & VALID and last[i] - first[i] >= 2:
            w = _longest_window(sums, i, first[i], last[i], w, limit)
            if w >= 0:
                a, b = max(first[i], i - HALF_WIDTHS[w]), min(last[i], i + HALF_WIDTHS[w])
            else:
                w = np.int64(0)
                a, b = _one_sided(sums, i, first[i], last[i], limit)
        windows[i, 0], windows[i, 1] = a, b


@part
def _fit_windows(sums, windows, geometry, noise, sigma_max, lines, flags):
    """Fill the lines (n, 5) of the windows, 0 where there is none, and flag the beams with one."""
    ox, oy = geometry[2], geometry[3]
    for i in range(len(windows)):
        a, b = np.int64(windows[i, 0]), np.int64(windows[i, 1])
        for k in range(5):
            lines[i, k] = 0.0
        if b - a < 2:
            continue
        mx, my, xx, yy, xy = _fit(sums, a, b)
        nx, ny = _normal(xx, yy, xy)
        d = nx * mx + ny * my
        # The normal points to the laser, which lies at the local origin: d is not positive.
        scale = (-1.0 if d > 0.0 else 1.0) / np.sqrt(nx * nx + ny * ny)
        nx, ny, d = nx * scale, ny * scale, d * scale
        variance = noise * noise / (ny * ny * xx - 2.0 * nx * ny * xy + nx * nx * yy)
        if not variance <= sigma_max * sigma_max:
            continue
        lines[i, 0], lines[i, 1] = nx, ny
        lines[i, 2] = d + nx * ox + ny * oy
        lines[i, 3] = variance
        lines[i, 4] = nx * (my + oy) - ny * (mx + ox)
        flags[i] |= LINE


@inlined
def _straight(sums, a, b, variance):
    """Whether points a..b lie on a line to within their noise, of the given variance (m^2).

    Two tests: the residuals scatter no more than noise does (three sigmas of the sample variance
    are allowed), and no third of the points lies off the line on average, which finds the shallow
    step or bow that a long window's scatter hides.
    """
    if b - a < 2:
        return False
    mx, my, xx, yy, xy = _fit(sums, a, b)
    # The smaller eigenvalue of the scatter is the squared residuals' sum; two degrees of freedom
    # went into the line.
    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    root2 = half * half + xy * xy
    surplus = middle - variance * ALLOWED[np.uintp(b - a - 1)]
    if surplus > 0.0 and surplus * surplus > root2:
        return False
    third = (b - a + 1) // 3
    if third < 2:
        return True
    # Across the line, of any length: of the two rows of (scatter - larger eigenvalue) the longer.
    root = np.sqrt(root2)
    if half >= 0.0:
        nx, ny = -xy, half + root
    else:
        nx, ny = root - half, -xy
    allowed = 9.0 * variance * third * (nx * nx + ny * ny)
    off = nx * mx + ny * my
    for k in range(3):
        i = a + k * third if k < 2 else b + 1 - third
        begin, end = np.uintp(i), np.uintp(i + third)
        x, y = sums[end, 0] - sums[begin, 0], sums[end, 1] - sums[begin, 1]
        apart = nx * x + ny * y - third * off
        if apart * apart > allowed:
            return False
    return True


@inlined
def _longest_window(sums, i, first, last, start, limit):
    """Index into HALF_WIDTHS of the longest straight window about i; -1 if there is none.

    From `start` it widens as long as the points are straight, or else narrows until they are.
    """
    w = start
    while True:
        h = HALF_WIDTHS[w]
        if _straight(sums, max(first, i - h), min(last, i + h), limit):
            whole = i - h <= first and i + h >= last
            if w < start or w + 1 == len(HALF_WIDTHS) or whole:
                return w
            w += 1
        else:
            w -= 1
            if w < 0 or w >= start:
                return w


@part
def _one_sided(sums, i, first, last, limit):
    """The longer straight window that ends or begins at i, for points at a corner."""
    a, b = i, i
    for side in range(2):
        for k in range(ONE_SIDED):
            reach = HALF_WIDTHS[k] + 1
            begin, end = (i - reach, i) if side == 0 else (i, i + reach)
            if begin < first or end > last or not _straight(sums, begin, end, limit):
                break
            if side == 0:
                a = begin
            else:
                b = end
    if i - a >= b - i:
        return a, i
    return i, b
