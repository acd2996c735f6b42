"""Selective Data Process: how complex is what the laser sees to the left and right?

After "Enhanced Robot Pose Estimation Method Using Selective Scan Data in Structured
Environments": complexity is the summed change of depth along a wall (Table I), and the summed
change of that change (Table III).  Table I as printed never resets its sum between layers; the
sums here are per layer and then averaged, which is what the symbol E_layer says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Profile = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WallSums:
    """The two complexity parameters of one wall, in the profile's unit of depth (m)."""

    diff: float  # sum of |diff|, Table I
    diff2: float  # sum of |diff2|, Table III


@dataclass(frozen=True, slots=True)
class PoseComplexity:
    """T_PE (Equation 2) and the four sums that it weighs."""

    t_pe: float
    left: WallSums
    right: WallSums

    @property
    def sums(self) -> tuple[float, float, float, float]:
        """|diff_L|, |diff2_L|, |diff_R|, |diff2_R| in the paper's order."""
        return self.left.diff, self.left.diff2, self.right.diff, self.right.diff2


def wall_sums(depth: Profile) -> WallSums:
    """Sums of |diff| and |diff2| of one depth profile (n,), nan where nothing was seen.

    A difference is taken between neighbouring samples only: gaps are skipped, not bridged.
    """
    diff = np.diff(depth)
    diff2 = np.diff(diff)
    return WallSums(float(np.nansum(np.abs(diff))), float(np.nansum(np.abs(diff2))))


def layered_sums(layers: Sequence[Profile]) -> WallSums:
    """Average of the sums over the layers of an object (Tables I and III); 0 without layers."""
    if not layers:
        return WallSums(0.0, 0.0)
    sums = [wall_sums(layer) for layer in layers]
    return WallSums(float(np.mean([s.diff for s in sums])), float(np.mean([s.diff2 for s in sums])))


def object_score(layers: Sequence[Profile], radius: float, c1: float, c2: float) -> float:
    """T of an object of the given radius (m), Equation 1.

    Raises:
        ValueError: the radius is not positive.
    """
    if not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    sums = layered_sums(layers)
    return (c1 * sums.diff + c2 * sums.diff2) / radius


def pose_score(left: WallSums, right: WallSums, weights: Sequence[float]) -> PoseComplexity:
    """T_PE of the two walls, Equation 2; `weights` are w1 to w4 in the paper's order."""
    w1, w2, w3, w4 = weights
    total = w1 * left.diff + w2 * left.diff2 + w3 * right.diff + w4 * right.diff2
    return PoseComplexity(total / 2, left, right)


def wall_profiles(
    points: NDArray[np.float64], reach: float, bin_width: float
) -> tuple[Profile, Profile]:
    """Depth profiles (m) of the left (y > 0) and right (y < 0) wall along the motion, x.

    Args:
        points: (n, 2) in the base frame, x along the motion; rows with nan are ignored.
        reach: how far ahead of and behind the robot the profile goes, m.
        bin_width: of the grid in x, m.

    Returns:
        Mean lateral distance per bin, (bins,) each; nan in bins that hold no point.
    """
    bins = max(1, round(2 * reach / bin_width))
    index = np.floor((points[:, 0] + reach) / bin_width)
    inside = (index >= 0) & (index < bins) & np.isfinite(points[:, 1])
    profiles = []
    for side in (1.0, -1.0):
        chosen = inside & (side * points[:, 1] > 0)
        at = index[chosen].astype(np.int64)
        count = np.bincount(at, minlength=bins).astype(np.float64)
        total = np.bincount(at, weights=side * points[chosen, 1], minlength=bins)
        profiles.append(np.divide(total, count, out=np.full(bins, np.nan), where=count > 0))
    return profiles[0], profiles[1]
