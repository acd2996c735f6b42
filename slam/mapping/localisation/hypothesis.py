"""One place where the robot may be, followed from scan to scan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.frontend.agreement import Agreement
from slam.frontend.match_types import MatchConfig, MatchResult, Prior
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan
from slam.mapping.keyframe_edges import widened
from slam.mapping.localisation.evidence import scan_evidence
from slam.mapping.localisation.fixed_map import FixedMap
from slam.mapping.registration import LEAST_PIECES

Matrix = NDArray[np.float64]

# By how much keyframes of one map disagree with each other, and a robot that carries its laser a
# little higher than then with all of them.
MAP_ERROR = np.diag([0.03, 0.03, math.radians(0.5)]) ** 2  # m, m, rad
FITTING_SHARE = 0.4  # of what is known, below which a match is none, as in `registration`
# A view renews itself with the way: what is seen again counts no second time.
RENEWED_M, RENEWED_RAD = 2.0, 2.0  # of way or turn; a half turn shows mostly new things
REFRESHED_S = 1.0  # s after which what a standing robot sees has taken the place of what it saw
MOST_LOG_ODDS = math.log(1000.0)  # a pose is never beyond doubt: robots are carried away


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """What the odometry says of the way from the last scan to this one."""

    moved: Pose2  # last_T_this
    covariance: Matrix  # (3, 3) in the frame of this scan
    seconds: float

    @property
    def renewed(self) -> float:
        """Share of what is seen that is new, 0 to 1."""
        way = math.hypot(self.moved.x(), self.moved.y()) / RENEWED_M
        return min(1.0, way + abs(self.moved.theta()) / RENEWED_RAD)

    @property
    def refreshed(self) -> float:
        """By how much a mean over the last scans follows this one, 0 to 1."""
        return 1.0 - math.exp(-self.seconds / REFRESHED_S - self.renewed)

    def then(self, more: Motion) -> Motion:
        """This motion and one more behind it."""
        turned = more.moved.inverse().AdjointMap()
        covariance = turned @ self.covariance @ turned.T + more.covariance
        return Motion(self.moved * more.moved, covariance, self.seconds + more.seconds)


@dataclass(frozen=True, eq=False, slots=True)
class Hypothesis:
    """A pose, how well it is known if it is right, and what speaks for it."""

    pose: Pose2  # map_T_base
    covariance: Matrix  # (3, 3) in the frame of the base
    log_odds: float  # nats, against a robot that is elsewhere
    mean_evidence: float  # nats of a scan, over the last ones
    matched: bool = False  # the last scan was matched

    def predicted(self, motion: Motion) -> Hypothesis:
        """Where the robot is after a motion, before its scan is looked at."""
        turned = motion.moved.inverse().AdjointMap()
        covariance = turned @ self.covariance @ turned.T + motion.covariance
        return replace(self, pose=self.pose * motion.moved, covariance=covariance, matched=False)

    def at(self, base: Pose2, result: MatchResult) -> Hypothesis:
        """With a match in the frame `base` (map_T_base) taken for right."""
        seen = widened(result.information, MAP_ERROR)
        covariance = np.linalg.inv(np.linalg.inv(self.covariance) + seen)
        pose = base * result.target_T_source
        return replace(self, pose=pose, covariance=0.5 * (covariance + covariance.T), matched=True)

    def weighed(self, seen: Agreement, motion: Motion) -> Hypothesis:
        """With what the scan says for it, of which only what is new counts for good."""
        evidence, share = scan_evidence(seen), motion.refreshed
        return replace(
            self,
            log_odds=self.log_odds + motion.renewed * evidence,
            mean_evidence=(1.0 - share) * self.mean_evidence + share * evidence,
        )


def bounded(ranked: list[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses, the likeliest one first, all less likely if that is beyond doubt.

    What they are against each other stays.
    """
    surplus = ranked[0].log_odds - MOST_LOG_ODDS if ranked else 0.0
    if surplus <= 0.0:
        return ranked
    return [replace(h, log_odds=h.log_odds - surplus) for h in ranked]


def holds(result: MatchResult, seen: Agreement) -> bool:
    """Whether enough of a scan fits for its match to be one."""
    return result.converged and seen.fitting >= LEAST_PIECES and seen.share >= FITTING_SHARE


def follow(
    hypothesis: Hypothesis, scan: PreparedScan, fixed_map: FixedMap, count: int,
    matcher: MatchConfig,
) -> tuple[Hypothesis, Agreement]:  # fmt: skip
    """Match a predicted hypothesis against `count` keyframes; its pose stays if that fails."""
    base, references = fixed_map.near(scan, hypothesis.pose, count)
    guess = base.between(hypothesis.pose)
    prior = Prior(guess, hypothesis.covariance + MAP_ERROR)
    result = match(references, scan, guess, matcher, prior)
    if result.converged:
        seen = fixed_map.seen(scan, base * result.target_T_source, matcher)
        if holds(result, seen):
            return hypothesis.at(base, result), seen
    return hypothesis, fixed_map.seen(scan, hypothesis.pose, matcher)
