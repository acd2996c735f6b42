"""After optimisation: sharpen the graph once more, then find every scan's own pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.frontend.batch_kernels import FITTING, INLIERS, LAST_STEP, PAIRS, THETA, TRIED, X
from slam.frontend.batch_matching import can_be_batched, match_each, view_of_each
from slam.frontend.match_types import TOLERANCE_M, MatchConfig, Prior, Reference
from slam.frontend.matching import CONVERGED_TOLERANCES, match
from slam.frontend.scan import PreparedScan
from slam.mapping.keyframe import Keyframe, view_centres

Matrix = NDArray[np.float64]
Matched = tuple[Pose2, float]  # map_T_base and the quality of the match


class LocaliseConfig(BaseModel):
    """Refinement after the loops are closed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    every_scan: bool = Field(True, description="match every scan, not only the keyframes")
    neighbours: int = Field(
        4, ge=1, description="keyframes with the most similar view that a scan is matched against"
    )
    sigma_trans: float = Field(0.10, gt=0, description="m, how far a guess may be off")
    sigma_rot: float = Field(0.05, gt=0, description="rad, how far a guess may be off")
    min_pair_inlier_fraction: float = Field(
        0.6, ge=0, le=1, description="share of pairs that must fit"
    )
    min_inlier_fraction: float = Field(
        0.3,
        ge=0,
        le=1,
        description="share of beams that must fit, or other starts are tried, and "
        "the guess is kept in the end",
    )
    good_inlier_fraction: float = Field(
        0.7,
        ge=0,
        le=1,
        description="share of beams that must fit where the odometry was found faulty, "
        "or other starts are tried",
    )


def covariance_of(config: LocaliseConfig) -> Matrix:
    """(3, 3) of the error of a guess."""
    return np.diag([config.sigma_trans, config.sigma_trans, config.sigma_rot]) ** 2


def _kd_tree(points: Matrix) -> Any:
    """A search tree over points (n, d); what it needs takes a quarter of a second to import."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


@dataclass(frozen=True, slots=True)
class _Located:
    """The scan before: where it was thought to be, where it was found, how fast it came there."""

    stamp_ns: int
    guess: Pose2
    found: Pose2
    velocity: Matrix | None  # (3,) m, m, rad a ns in its own frame


class ScanLocaliser:
    """Finds the pose of scans, one after the other, among the optimised keyframes.

    A scan is matched against the keyframes whose view is the most like its own: that look at about
    the same from about the same place.  One that looks at the same from the other side shows other
    faces of it, and pulls the match along.
    """

    def __init__(
        self, keyframes: Sequence[Keyframe], poses: Matrix, config: LocaliseConfig,
        matcher: MatchConfig,
    ) -> None:  # fmt: skip
        self._keyframes = keyframes
        self._at = np.ascontiguousarray(poses)
        self._poses = [Pose2(*pose) for pose in poses]
        self._tree = _kd_tree(np.hstack([view_centres(keyframes, poses), poses[:, :2]]))
        self._config = config
        self._matcher = matcher
        self._covariance = covariance_of(config)
        self._sigmas = np.sqrt(np.diag(self._covariance))
        self._last: _Located | None = None
        self.matches = 0

    def locate(
        self, scan: PreparedScan, guess: Pose2, odometry_faulty: bool = False,
        first: Matched | None = None, reach_m: float = math.inf,
    ) -> Pose2:  # fmt: skip
        """map_T_base of the next scan; the guess where nothing better is found.

        The match from the guess needs no scan before it: who has made it already hands it in as
        `first`.

        Where the odometry is wrong between two keyframes, or late in a turn, the guess is off by
        more than it should: then the search starts again from where the last scan was found.  A
        match from the guess is good enough unless that odometry is faulty: in a corridor other
        starts find other places that look alike.  What they find farther off than `reach_m`, and
        a guess may be, is out of the question.
        """
        enough = (
            self._config.good_inlier_fraction
            if odometry_faulty
            else self._config.min_inlier_fraction
        )
        best, best_inlier_fraction = guess, self._config.min_inlier_fraction
        farthest = reach_m + 3.0 * self._config.sigma_trans
        for start in (guess, *self._other_starts(scan.stamp_ns, guess)):
            found, inlier_fraction = first or self.match_from(scan, start)
            first = None
            self.matches += 1
            away = guess.between(found)
            if inlier_fraction > best_inlier_fraction and np.hypot(away.x(), away.y()) <= farthest:
                best, best_inlier_fraction = found, inlier_fraction
            if best_inlier_fraction > enough:
                break
        self._last = self._located(scan.stamp_ns, guess, best)
        return best

    def _other_starts(self, stamp_ns: int, guess: Pose2) -> list[Pose2]:
        """From the last scan on: as the odometry says, at the same speed, or not at all."""
        last = self._last
        if last is None:
            return []
        starts = [last.found * last.guess.between(guess)]
        if last.velocity is not None:
            starts.append(last.found * Pose2.Expmap(last.velocity * (stamp_ns - last.stamp_ns)))
        return [*starts, last.found]

    def _located(self, stamp_ns: int, guess: Pose2, found: Pose2) -> _Located:
        last, velocity = self._last, None
        if last is not None and stamp_ns > last.stamp_ns:
            velocity = Pose2.Logmap(last.found.between(found)) / (stamp_ns - last.stamp_ns)
        return _Located(stamp_ns, guess, found, velocity)

    def match_batch(self, scans: Sequence[PreparedScan], guesses: Matrix) -> list[Matched]:
        """What `match_from` gives for each scan from its guess (n, 3), to the bit.

        It changes nothing here, so that several threads may call it at once.
        """
        near = self._nearest(view_of_each(scans, guesses))
        used, rows = np.unique(near, return_inverse=True)
        keyframes = [self._keyframes[k].prepared for k in used.tolist()]
        if not (can_be_batched(keyframes, self._matcher) and np.isfinite(guesses).all()):
            places = zip(scans, guesses, strict=True)
            return [self.match_from(scan, Pose2(*guess)) for scan, guess in places]
        found = match_each(
            scans, guesses, keyframes, self._at[used], rows.reshape(near.shape), self._covariance,
            self._matcher,
        )  # fmt: skip
        bases = [self._poses[k] for k in near[:, 0].tolist()]
        return [
            self._judged(base, Pose2(*guess), row)
            for base, guess, row in zip(bases, guesses.tolist(), found.tolist(), strict=True)
        ]

    def match_from(self, scan: PreparedScan, guess: Pose2) -> Matched:
        """The pose matched from one start and its quality, 0 where it is refused."""
        at = np.array([[guess.x(), guess.y(), guess.theta()]])
        near = self._nearest(view_of_each([scan], at))[0].tolist()
        base = self._poses[near[0]]
        references = [
            Reference(base.between(self._poses[n]), self._keyframes[n].prepared) for n in near
        ]
        prior = Prior(base.between(guess), self._covariance)
        result = match(references, scan, prior.target_T_source, self._matcher, prior)
        if not result.converged:
            return guess, 0.0
        return self._accepted(
            base, guess, result.target_T_source, result.pair_inlier_fraction,
            result.inlier_fraction,
        )  # fmt: skip

    def _nearest(self, views: Matrix) -> NDArray[np.int64]:
        """(n, k) the keyframes with the most similar views."""
        count = min(self._config.neighbours, len(self._poses))
        near: NDArray[np.int64] = self._tree.query(views, k=count)[1]
        return near.reshape(len(views), count)

    def _judged(self, base: Pose2, guess: Pose2, row: list[float]) -> Matched:
        """What `match` would say to a row of `match_each`."""
        if (
            row[PAIRS] < self._matcher.min_pairs
            or row[LAST_STEP] > CONVERGED_TOLERANCES * TOLERANCE_M
        ):
            return guess, 0.0
        pair_inlier_fraction = row[INLIERS] / row[PAIRS]
        if pair_inlier_fraction < self._matcher.min_pair_inlier_fraction:
            return guess, 0.0
        found = Pose2(*row[X : THETA + 1])
        return self._accepted(base, guess, found, pair_inlier_fraction, row[FITTING] / row[TRIED])

    def _accepted(
        self, base: Pose2, guess: Pose2, base_T_found: Pose2, pair_inlier_fraction: float,
        inlier_fraction: float,
    ) -> Matched:  # fmt: skip
        """The match, unless too few of its pairs fit or it is too far from the guess."""
        if pair_inlier_fraction < self._config.min_pair_inlier_fraction:
            return guess, 0.0
        error = np.abs(Pose2.Logmap(base.between(guess).between(base_T_found)))
        if (error > 3.0 * self._sigmas).any():
            return guess, 0.0
        return base * base_T_found, inlier_fraction
