"""`slam.match`: two scans in, the motion between them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import ArrayLike, NDArray

from slam.frontend.match_types import Prior, Reference
from slam.frontend.matching import match as match_scans
from slam.frontend.scan import PreparedScan, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan
from slam.mapping.config import SlamConfig


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep; beam i points at `angle_min + i * angle_step` in the laser frame."""

    ranges: ArrayLike  # (n,) m; inf where nothing came back
    angle_min: float  # rad
    angle_step: float  # rad, anticlockwise
    range_max: float = float("inf")  # m


@dataclass(frozen=True, eq=False)
class Match:
    """Where scan b was taken, seen from scan a."""

    pose: tuple[float, float, float]  # a_T_b: x (m), y (m), theta (rad)
    covariance: NDArray[np.float64]  # (3, 3) of (x, y, theta) in the frame of b
    degenerate_direction: float | None  # rad, in the frame of b, that the scans leave open
    inlier_fraction: float  # share of the beams of b that fit a line of a
    converged: bool
    reason: str  # why it was refused; empty if it was not


def match(
    scan_a: Scan,
    scan_b: Scan,
    guess: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    sigma: Sequence[float] | None = None,
    config: SlamConfig | None = None,
) -> Match:
    """Align scan b to scan a.

    Args:
        scan_a: the fixed scan.
        scan_b: the one to be placed.
        guess: a_T_b where the search begins: m, m, rad.
        sigma: (3,) how far the guess may be off (m, m, rad); None if nothing is known, and then
            starts within 0.4 m and 0.42 rad of it are tried as well.
        config: settings; None takes the defaults.

    A refused match is an outcome: `converged` is False and `reason` says why.
    """
    settings = config or SlamConfig()
    start = Pose2(*(float(value) for value in guess))
    prior = None
    if sigma is not None:
        prior = Prior(start, np.diag(np.asarray(sigma, dtype=np.float64)) ** 2)
    references = [Reference(Pose2(), _prepared(scan_a, settings))]
    found = match_scans(references, _prepared(scan_b, settings), start, settings.matcher, prior)
    at = found.target_T_source
    return Match(
        (at.x(), at.y(), at.theta()), found.covariance, found.degenerate_direction,
        found.inlier_fraction, found.converged, found.reason,
    )  # fmt: skip


def _prepared(scan: Scan, settings: SlamConfig) -> PreparedScan:
    ranges = np.array(scan.ranges, dtype=np.float32)
    message = LaserScan(0, scan.angle_min, scan.angle_step, ranges, 0.0, scan.range_max)
    return prepare(message, LaserExtrinsics(0, 0.0, 0.0, 0.0), settings.scan)
