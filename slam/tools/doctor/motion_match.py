"""The laser's step over a pair of scans, where the scans determine it.

A match ends in an answer whether there is one or not.  Before it may accuse wheels it has to
be the only one, to be found again by way of a scan in between, and the wheels' own answer must
explain the scans clearly less well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2

from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan
from slam.tools.doctor.motion_pairs import Pair

NO_MOUNT = LaserExtrinsics(0, 0.0, 0.0, 0.0)
GOOD_QUALITY, GOOD_EXPLAINED = 0.6, 0.7
SEES_M = 0.02  # sigma along the axis that the scans see worst
RIVAL = 0.85  # of the best quality: as good an answer, if it is another one
RIVAL_SIGMAS = 3.0  # or within this much of the difference that chance makes between two shares
SAME_M, SAME_RAD = 0.05, 0.03  # within these it is the same answer
_NEAR_WHEELS = np.diag([0.03, 0.03, 0.03]) ** 2  # m, m, rad: an answer that agrees with them
_MATCHER = MatchConfig()


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A pair whose scans determine the step."""

    pair: Pair
    laser: Pose2  # first_T_second of the laser, by matching


class PairMatcher:
    """Matches pairs; neighbours share a scan, which is prepared once."""

    def __init__(self, base_T_laser: Pose2) -> None:
        self._base_T_laser = base_T_laser
        self._last: tuple[LaserScan, PreparedScan] | None = None

    def judge(self, pair: Pair) -> Judged | None:
        """The laser's step; None if the scans do not determine it."""
        first, second = self._prepared(pair.first), self._prepared(pair.second)
        by_wheels = self._base_T_laser.inverse() * pair.step * self._base_T_laser
        results = _from_everywhere(first, second, by_wheels)
        best = _best(results)
        if not _sure(best):
            return None
        results.append(
            match(
                [Reference(Pose2(), first)], second, by_wheels, _MATCHER,
                Prior(by_wheels, _NEAR_WHEELS),
            )
        )  # fmt: skip
        if any(_rivals(best, result, second.valid) for result in results):
            return None
        if not self._found_again(pair, first, second, best.target_T_source):
            return None
        return Judged(pair, best.target_T_source)

    def _found_again(
        self, pair: Pair, first: PreparedScan, second: PreparedScan, laser: Pose2
    ) -> bool:
        """Whether two matches by way of the scan in between, if there is one, end there too."""
        if pair.between is None:
            return True
        between = prepare(pair.between, NO_MOUNT, ScanConfig())
        half = Pose2.Expmap(0.5 * Pose2.Logmap(laser))
        one = _best(_from_everywhere(first, between, half))
        two = _best(_from_everywhere(between, second, half))
        return same_answer(one.target_T_source * two.target_T_source, laser)

    def _prepared(self, scan: LaserScan) -> PreparedScan:
        if self._last is None or self._last[0] is not scan:
            self._last = scan, prepare(scan, NO_MOUNT, ScanConfig())
        return self._last[1]


def _from_everywhere(first: PreparedScan, second: PreparedScan, guess: Pose2) -> list[MatchResult]:
    """Matches from a guess, from rest, and from the opposite: each is right for some fault."""
    starts = (guess, Pose2(), guess.inverse())
    return [match([Reference(Pose2(), first)], second, start, _MATCHER) for start in starts]


def _best(results: list[MatchResult]) -> MatchResult:
    return max(results, key=lambda result: result.inlier_fraction * result.converged)


def same_answer(a: Pose2, b: Pose2) -> bool:
    """Whether two steps are one within what a match is good for."""
    apart = a.between(b)
    return max(abs(apart.x()), abs(apart.y())) <= SAME_M and abs(apart.theta()) <= SAME_RAD


def _rivals(best: MatchResult, other: MatchResult, beams: int) -> bool:
    """Whether another match ends elsewhere and explains the scan about as well."""
    share = best.inlier_fraction
    chance = math.sqrt(2.0 * share * (1.0 - share) / max(beams, 1))  # sigma of the difference
    as_good = min(RIVAL * share, share - RIVAL_SIGMAS * chance)
    if not other.converged or other.inlier_fraction < as_good:
        return False
    return not same_answer(best.target_T_source, other.target_T_source)


def _sure(result: MatchResult) -> bool:
    if not result.converged or result.inlier_fraction < GOOD_QUALITY:
        return False
    if result.pair_inlier_fraction < GOOD_EXPLAINED:
        return False
    return float(np.linalg.eigvalsh(result.covariance[:2, :2])[-1]) < SEES_M**2
