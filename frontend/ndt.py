"""Normal distributions transform (Biber and Strasser 2003): points against Gaussian cells."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import allocating_part, kernel
from slam.frontend.icp_kernels import solve3

MIN_POINTS = 5  # a cell with fewer has no shape
MIN_RATIO = 0.001  # smallest eigenvalue of a cell over its largest, as in the paper


@kernel
def build_cells(points, cell):
    """Gaussians of four grids of `cell` (m), shifted by half a cell against each other.

    Args:
        points: (n, 2) m.
        cell: m.

    Returns:
        (cells, origin, shape): (4, rows * columns, 5) mean x, y and inverse covariance xx, xy,
        yy (all 0 where a cell is empty), the first grid's corner (2,), and (rows, columns).
    """
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(points)):
        low_x, low_y = min(low_x, points[k, 0]), min(low_y, points[k, 1])
        high_x, high_y = max(high_x, points[k, 0]), max(high_y, points[k, 1])
    low_x, low_y = low_x - cell, low_y - cell
    columns = int((high_x - low_x) / cell) + 2
    rows = int((high_y - low_y) / cell) + 2
    sums = np.zeros((4, rows * columns, 6))
    for k in range(len(points)):
        for grid in range(4):
            x = (points[k, 0] - low_x) / cell + 0.5 * (grid % 2)
            y = (points[k, 1] - low_y) / cell + 0.5 * (grid // 2)
            at = int(y) * columns + int(x)
            dx, dy = points[k, 0] - low_x, points[k, 1] - low_y
            sums[grid, at, 0] += 1.0
            sums[grid, at, 1] += dx
            sums[grid, at, 2] += dy
            sums[grid, at, 3] += dx * dx
            sums[grid, at, 4] += dx * dy
            sums[grid, at, 5] += dy * dy
    cells = np.zeros((4, rows * columns, 5))
    for grid in range(4):
        for at in range(rows * columns):
            m = sums[grid, at, 0]
            if m < MIN_POINTS:
                continue
            mx, my = sums[grid, at, 1] / m, sums[grid, at, 2] / m
            xx = sums[grid, at, 3] / m - mx * mx
            xy = sums[grid, at, 4] / m - mx * my
            yy = sums[grid, at, 5] / m - my * my
            half = 0.5 * (xx + yy)
            root = np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
            # Raise the small eigenvalue: a straight wall would make the matrix singular.
            lift = max(MIN_RATIO * (half + root) - (half - root), 0.0) + 1e-9
            angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
            nx, ny = -np.sin(angle), np.cos(angle)
            xx, xy, yy = xx + lift * nx * nx, xy + lift * nx * ny, yy + lift * ny * ny
            det = xx * yy - xy * xy
            cells[grid, at, 0], cells[grid, at, 1] = mx + low_x, my + low_y
            cells[grid, at, 2], cells[grid, at, 3] = yy / det, -xy / det
            cells[grid, at, 4] = xx / det
    origin = np.empty(2)
    origin[0], origin[1] = low_x, low_y
    return cells, origin, (rows, columns)


@allocating_part
def _derivatives(cells, origin, columns, rows, cell, source, pose, gradient, hessian):
    """Fill gradient (3,) and Hessian (3, 3) of minus the score (Equations 8 to 12); the score."""
    for k in range(3):
        gradient[k] = 0.0
        for m in range(3):
            hessian[k, m] = 0.0
    score = 0.0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    jacobian = np.zeros((2, 3))
    jacobian[0, 0] = jacobian[1, 1] = 1.0
    for i in range(len(source)):
        rx, ry = c * source[i, 0] - s * source[i, 1], s * source[i, 0] + c * source[i, 1]
        px, py = rx + pose[0], ry + pose[1]
        jacobian[0, 2], jacobian[1, 2] = -ry, rx
        for grid in range(4):
            x = (px - origin[0]) / cell + 0.5 * (grid % 2)
            y = (py - origin[1]) / cell + 0.5 * (grid // 2)
            if x < 0.0 or y < 0.0 or x >= columns or y >= rows:
                continue
            at = int(y) * columns + int(x)
            if cells[grid, at, 2] == 0.0:
                continue
            qx, qy = px - cells[grid, at, 0], py - cells[grid, at, 1]
            ax = cells[grid, at, 2] * qx + cells[grid, at, 3] * qy
            ay = cells[grid, at, 3] * qx + cells[grid, at, 4] * qy
            value = np.exp(-0.5 * (qx * ax + qy * ay))
            score += value
            for k in range(3):
                slope = ax * jacobian[0, k] + ay * jacobian[1, k]
                gradient[k] += value * slope
                for m in range(3):
                    other = ax * jacobian[0, m] + ay * jacobian[1, m]
                    bx = cells[grid, at, 2] * jacobian[0, m] + cells[grid, at, 3] * jacobian[1, m]
                    by = cells[grid, at, 3] * jacobian[0, m] + cells[grid, at, 4] * jacobian[1, m]
                    curve = bx * jacobian[0, k] + by * jacobian[1, k] - slope * other
                    if k == 2 and m == 2:
                        curve -= ax * rx + ay * ry
                    hessian[k, m] += value * curve
    return score


@kernel
def ndt(cells, origin, shape, cell, source, pose, iterations, tolerance):
    """Newton's method on minus the score from `pose` (3,), overwritten; (last step, iterations).

    The Hessian is lifted until it is positive definite, and a step that lowers the score is
    halved, as the paper advises for Newton's method far from the minimum.
    """
    rows, columns = shape
    gradient, hessian = np.zeros(3), np.zeros((3, 3))
    trial, step, upper = np.zeros(3), np.zeros(3), np.zeros(6)
    spare_g, spare_h = np.zeros(3), np.zeros((3, 3))
    size = np.inf
    for iteration in range(iterations):
        score = _derivatives(cells, origin, columns, rows, cell, source, pose, gradient, hessian)
        if score < 1e-6:
            return np.inf, iteration + 1
        lift = 1e-9
        for _ in range(20):
            upper[0], upper[1], upper[2] = hessian[0, 0] + lift, hessian[0, 1], hessian[0, 2]
            upper[3], upper[4], upper[5] = hessian[1, 1] + lift, hessian[1, 2], hessian[2, 2] + lift
            if solve3(upper, gradient, step):
                break
            lift = max(10.0 * lift, 1e-3 * abs(hessian[2, 2]))
        else:
            return np.inf, iteration + 1
        length = np.sqrt(step[0] ** 2 + step[1] ** 2)
        shorten = min(1.0, 0.5 * cell / max(length, 1e-12), 0.2 / max(abs(step[2]), 1e-12))
        for _ in range(6):
            for k in range(3):
                step[k] *= shorten
                trial[k] = pose[k] + step[k]
            after = _derivatives(
                cells, origin, columns, rows, cell, source, trial, spare_g, spare_h
            )
            if after >= score:
                break
            shorten = 0.5
        for k in range(3):
            pose[k] = trial[k]
        size = max(abs(step[0]) + abs(step[1]), 5.0 * abs(step[2]))
        if size < tolerance:
            return size, iteration + 1
    return size, iterations
