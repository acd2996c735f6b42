"""Point-to-point ICP with the choices that the paper leaves open, for the study of what they do.

Nearest points are found by trying all: slow, and beyond doubt.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def open_icp(source, target, pose, gate, one_to_one, keep, iterations, tolerance):
    """Move `pose` (3,), target_T_source, until the nearest points agree best.

    Args:
        source: (n, 2) points, m.
        target: (m, 2) points, m.
        pose: x, y (m), theta (rad); the guess, overwritten.
        gate: m, farther points are no pair.
        one_to_one: of several points with the same nearest one, only the closest is its pair.
        keep: share of the pairs that is used, the shortest ones.
        iterations: at most.
        tolerance: m, a smaller step ends the iteration (radians count fivefold).
    """
    correspondence = np.empty(len(source), np.int64)
    square = np.empty(len(source))
    moved = np.empty(source.shape)
    for _ in range(iterations):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        for i in range(len(source)):
            moved[i, 0] = c * source[i, 0] - s * source[i, 1] + pose[0]
            moved[i, 1] = s * source[i, 0] + c * source[i, 1] + pose[1]
        nearest(moved, target, gate * gate, correspondence, square)
        if one_to_one:
            one_to_one_pairs(correspondence, square, len(target))
        if keep < 1.0:
            drop_longest(correspondence, square, keep)
        turn, x, y, pairs = rigid_motion(moved, target, correspondence)
        if pairs < 3:
            return
        c, s = np.cos(turn), np.sin(turn)
        x += c * pose[0] - s * pose[1]
        y += s * pose[0] + c * pose[1]
        size = abs(x - pose[0]) + abs(y - pose[1]) + 5.0 * abs(turn)
        pose[0], pose[1], pose[2] = x, y, pose[2] + turn
        if size < tolerance:
            return


@njit(cache=True, nogil=True)
def nearest(points, target, most, correspondence, square):
    """Write the index of each point's nearest target within `most` (m^2), else -1, and both's."""
    for i in range(len(points)):
        correspondence[i], square[i] = -1, most
        for j in range(len(target)):
            dx, dy = points[i, 0] - target[j, 0], points[i, 1] - target[j, 1]
            if dx * dx + dy * dy < square[i]:
                correspondence[i], square[i] = j, dx * dx + dy * dy


@njit(cache=True, nogil=True)
def one_to_one_pairs(correspondence, square, targets):
    """Leave each target to the closest of those that chose it."""
    owner = np.full(targets, -1)
    for i in range(len(correspondence)):
        j = correspondence[i]
        if j < 0:
            continue
        if owner[j] < 0 or square[i] < square[owner[j]]:
            if owner[j] >= 0:
                correspondence[owner[j]] = -1
            owner[j] = i
        else:
            correspondence[i] = -1


@njit(cache=True, nogil=True)
def drop_longest(correspondence, square, keep):
    """Keep the share `keep` of the pairs, the shortest."""
    lengths = np.sort(square[correspondence >= 0])
    if len(lengths) == 0:
        return
    most = lengths[min(int(keep * len(lengths)), len(lengths) - 1)]
    for i in range(len(correspondence)):
        if square[i] > most:
            correspondence[i] = -1


@njit(cache=True, nogil=True)
def rigid_motion(points, target, correspondence):
    """Turn (rad), shift x, y (m) that align points with their correspondences; pairs."""
    pairs, sx, sy, tx, ty, dot, cross = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(points)):
        if correspondence[i] < 0:
            continue
        px, py = points[i, 0], points[i, 1]
        qx, qy = target[correspondence[i], 0], target[correspondence[i], 1]
        pairs += 1
        sx, sy, tx, ty = sx + px, sy + py, tx + qx, ty + qy
        dot += px * qx + py * qy
        cross += px * qy - py * qx
    if pairs == 0:
        return 0.0, 0.0, 0.0, 0
    sx, sy, tx, ty = sx / pairs, sy / pairs, tx / pairs, ty / pairs
    turn = np.arctan2(cross - pairs * (sx * ty - sy * tx), dot - pairs * (sx * tx + sy * ty))
    c, s = np.cos(turn), np.sin(turn)
    return turn, tx - c * sx + s * sy, ty - s * sx - c * sy, pairs
