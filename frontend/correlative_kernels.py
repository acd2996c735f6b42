"""Numba kernels of the correlative search: likelihood field, block maxima, branch and bound."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import bare_kernel, kernel, part


@kernel
def stamp(points, low, resolution, smoothing, grid):
    """Write each point's likelihood into the cells around it, keeping the maximum."""
    reach = int(np.ceil(3.0 * smoothing / resolution))
    rows, columns = grid.shape
    across = np.empty(2 * reach + 1)  # the Gaussian is a product of one in x and one in y
    for k in range(len(points)):
        px = (points[k, 0] - low[0]) / resolution
        py = (points[k, 1] - low[1]) / resolution
        cx, cy = int(px), int(py)
        left, right = max(0, cx - reach), min(columns, cx + reach + 1)
        for x in range(left, right):
            dx = (x + 0.5 - px) * resolution / smoothing
            across[x - left] = np.exp(-0.5 * dx * dx)
        for y in range(max(0, cy - reach), min(rows, cy + reach + 1)):
            dy = (y + 0.5 - py) * resolution / smoothing
            along = np.exp(-0.5 * dy * dy)
            for x in range(left, right):
                # Written whether larger or not: an unpredictable branch costs more.
                grid[y, x] = max(grid[y, x], np.float32(along * across[x - left]))


@bare_kernel
def block_maximum(finer, shift, coarser):
    """coarser[y, x] = maximum of finer over the block twice as wide that begins at (y, x)."""
    rows, columns = finer.shape
    for y in range(rows):
        for x in range(columns):
            value = finer[y, x]
            if x + shift < columns:
                value = max(value, finer[y, x + shift])
            if y + shift < rows:
                value = max(value, finer[y + shift, x])
                if x + shift < columns:
                    value = max(value, finer[y + shift, x + shift])
            coarser[y, x] = value


@part
def _score(grid, block, xs, ys, dx, dy):
    """Mean of the grid at the points shifted by (dx, dy) cells; blocks reach beyond the edge."""
    rows, columns = grid.shape
    total = 0.0
    for k in range(len(xs)):
        x, y = xs[k] + dx, ys[k] + dy
        if x >= columns or y >= rows or x <= -block or y <= -block:
            continue
        # A block that begins before the first cell still covers it: its maximum is not larger
        # than that of the block of the same size at the edge.
        total += grid[max(y, 0), max(x, 0)]
    return total / len(xs)


@part
def blocks_per_axis(levels, cells):
    """How many of the coarsest blocks cover `cells` to either side of the centre."""
    return (2 * cells) // (1 << (levels - 1)) + 1


@bare_kernel
def bound_blocks(levels, points, angles, x0, y0, cells, xs, ys, bounds):
    """Fill the cells of the points turned by each angle, and the bound of each coarsest block.

    Shapes: xs, ys (angles, points), bounds (angles * blocks,).
    """
    top = len(levels) - 1
    block = 1 << top
    per_axis = blocks_per_axis(len(levels), cells)
    n = len(points)
    for a in range(len(angles)):
        c, s = np.cos(angles[a]), np.sin(angles[a])
        for k in range(n):
            xs[a, k] = int(np.floor(c * points[k, 0] - s * points[k, 1] + x0))
            ys[a, k] = int(np.floor(s * points[k, 0] + c * points[k, 1] + y0))
        for iy in range(per_axis):
            for ix in range(per_axis):
                node = (a * per_axis + iy) * per_axis + ix
                bounds[node] = _score(
                    levels[top], block, xs[a], ys[a], ix * block - cells, iy * block - cells
                )


@bare_kernel
def branch_and_bound(levels, points, nodes, angles, cells, min_score, excluded, stack, best):
    """Depth-first over blocks, the most promising first; fills best (score, dx, dy, angle).

    `points` are (xs, ys) of `bound_blocks`; `nodes` are its bounds and their order, largest first.
    `excluded` is (dx, dy, radius) in cells: poses nearer than radius do not count.
    `stack` (4 levels + 4, 4) is scratch: bound, level, dx, dy.
    """
    (xs, ys), (bounds, order) = points, nodes
    top = len(levels) - 1
    block = 1 << top
    per_axis = blocks_per_axis(len(levels), cells)
    best[0] = min_score
    found = False
    radius2 = excluded[2] * excluded[2] if excluded[2] > 0.0 else -1.0
    for node in order:
        if bounds[node] <= best[0]:
            break
        a = node // (per_axis * per_axis)
        rest = node % (per_axis * per_axis)
        stack[0, 0], stack[0, 1] = bounds[node], top
        stack[0, 2] = (rest % per_axis) * block - cells
        stack[0, 3] = (rest // per_axis) * block - cells
        size = 1
        while size > 0:
            size -= 1
            bound, level = stack[size, 0], int(stack[size, 1])
            dx, dy = int(stack[size, 2]), int(stack[size, 3])
            if bound <= best[0]:
                continue
            if level == 0:
                ex, ey = dx - excluded[0], dy - excluded[1]
                if abs(dx) <= cells and abs(dy) <= cells and ex * ex + ey * ey > radius2:
                    best[0], best[1], best[2], best[3] = bound, dx, dy, angles[a]
                    found = True
                continue
            half = 1 << (level - 1)
            begin = size
            for child in range(4):
                cx, cy = dx + (child & 1) * half, dy + (child >> 1) * half
                value = _score(levels[level - 1], half, xs[a], ys[a], cx, cy)
                if value <= best[0]:
                    continue
                at = size  # insertion keeps the best child on top of the stack
                while at > begin and stack[at - 1, 0] > value:
                    for k in range(4):
                        stack[at, k] = stack[at - 1, k]
                    at -= 1
                stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = value, level - 1, cx, cy
                size += 1
    return found
