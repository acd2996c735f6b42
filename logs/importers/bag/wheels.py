"""Odometry that jumps where no robot can: single spikes, and counters set back to zero."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

SPIKE_M, SPIKE_M_S = 10.0, 30.0
"""A step longer than this and faster than this was driven by no robot."""

ZERO_M, ZERO_RAD = 0.05, 0.05  # so near the origin lies a pose after the counters were set back
RESET_LEAST_M, RESET_LEAST_RAD = 0.3, 0.5  # so far from it the pose before
RESET_M_S, RESET_RAD_S = 3.0, 6.3  # a P3-DX does 1.2 m/s and 5.2 rad/s

Poses = NDArray[np.float64]


def spikes(stamps: NDArray[np.int64], poses: Poses) -> NDArray[np.bool_]:
    """Return which poses, (n,), stand alone where no robot can have been.

    `stamps` (n,) in ns and `poses` (n, 3) are those of one drive in order of time.
    """
    n = len(stamps)
    wild = np.zeros(n, dtype=np.bool_)
    if n < 3:
        return wild
    leaps = _leaps(stamps, poses)  # from each pose to the next
    over = _leaps(stamps[::2], poses[::2]), _leaps(stamps[1::2], poses[1::2])
    past = np.empty(n - 2, dtype=np.bool_)  # from each pose to the one after the next
    past[::2], past[1::2] = over[0][: len(past[::2])], over[1][: len(past[1::2])]
    wild[1:-1] = leaps[:-1] & leaps[1:] & ~past
    wild[0] = leaps[0] and not leaps[1]
    wild[-1] = leaps[-1] and not leaps[-2]
    return wild


def _leaps(stamps: NDArray[np.int64], poses: Poses) -> NDArray[np.bool_]:
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    return np.asarray(steps > SPIKE_M + SPIKE_M_S * np.maximum(np.diff(stamps) * 1e-9, 0.0))


def carried_on(stamps: NDArray[np.int64], poses: Poses, changed: Counter[str]) -> Poses:
    """Return the poses, (n, 3), with those after a reset to zero carried on from before it.

    What was driven between the last pose before and the first after is lost.
    """
    resets = _resets(stamps, poses)
    if not len(resets):
        return poses
    changed["odometry set back to zero, carried on from where it was"] += len(resets)
    result = poses.copy()
    for start, end in zip(resets, [*resets[1:], len(poses)], strict=True):
        x, y, theta = result[start - 1]
        c, s = np.cos(theta), np.sin(theta)
        local = poses[start:end] - [*poses[start, :2], 0.0]
        turned = local[:, 2] - poses[start, 2]
        back = -poses[start, 2]
        cb, sb = np.cos(back), np.sin(back)
        along, aside = cb * local[:, 0] - sb * local[:, 1], sb * local[:, 0] + cb * local[:, 1]
        result[start:end, 0] = x + c * along - s * aside
        result[start:end, 1] = y + s * along + c * aside
        result[start:end, 2] = np.remainder(theta + turned + np.pi, 2 * np.pi) - np.pi
    return result


def _resets(stamps: NDArray[np.int64], poses: Poses) -> list[int]:
    """Return the rows at which the counters begin again at the origin."""
    if len(poses) < 2:
        return []
    seconds = np.maximum(np.diff(stamps) * 1e-9, 0.0)
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turns = np.abs(np.remainder(np.diff(poses[:, 2]) + np.pi, 2 * np.pi) - np.pi)
    at_zero = (np.hypot(poses[1:, 0], poses[1:, 1]) < ZERO_M) & (np.abs(poses[1:, 2]) < ZERO_RAD)
    leaps = (steps > RESET_LEAST_M + RESET_M_S * seconds) | (
        turns > RESET_LEAST_RAD + RESET_RAD_S * seconds
    )
    return [int(k) + 1 for k in np.flatnonzero(at_zero & leaps)]
