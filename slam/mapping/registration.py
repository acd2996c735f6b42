"""Registers a scan to the keyframes before it, and decides between odometry and scan match.

Two explanations compete: the odometry is right, or it has a fault.  Each is as likely as what it
says of the motion before the scan is looked at, times what the scan says of it:

- Right: the match found with the odometry as its prior, weighed by the odometry's error model.
- A fault has a small probability, larger after a fault.  A known kind (motion of the wrong sign,
  none where there is some, some where there is none) says where the robot is as exactly as the
  odometry would.  Any other fault leaves all motion open that the robot can make.
- The scan speaks in independent pieces of surface (`agreement`): repeated structure differs in few
  of them between one place and the next, and a person who walks along is one.

- Rarely, the robot was carried elsewhere: then the whole scan is new.

The logarithm of their ratio decides.  "Holds" means that enough pieces fit the match:

    | odds of a fault | match holds | match                | odometry           |
    |-----------------|-------------|----------------------|--------------------|
    | against         | yes         | used                 | used               |
    | unsure          | yes         | used with wide noise | used with wide noise |
    | for             | yes         | used                 | refused            |
    | any             | no          | refused              | used, wide; refused if impossible |
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.chi_square import mahalanobis
from slam.frontend.agreement import NEW_NATS, Agreement, agreement
from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan
from slam.mapping.match_starts import searched_starts

# Faults that a match can confirm by mistake: motion of the wrong sign, motion where there is none,
# and none where there is.  Each has a start that would be right.
KNOWN_FAULTS = ("mirrored translation", "zero motion", "previous velocity")
LOOSE_COVARIANCE = np.diag([0.3, 0.3, 0.2]) ** 2  # m, m, rad: hardly holds a match
DISTINCT_M = 0.03  # m between the ends of two matches that are different hypotheses
DOUBT_INFLATION = 5.0  # factor on the sigmas of an odometry that does not look right
JOINING_COVARIANCE = np.diag([0.05, 0.05, 0.03]) ** 2  # m, m, rad: holds a pose found by one match
SURE_NATS = math.log(100.0)  # odds of a hundred to one decide
NEVER = 1e-12  # probability of what cannot be, or is not looked for
AFTER_FAULT = 0.3  # probability of a fault right after one: they last some seconds
# What is known of the rate of faults before the log tells more: as much as if in a thousand steps
# a tenth of a fault had been seen.
STEPS_BEFORE, FAULTS_BEFORE = 1000.0, 0.1
LEAST_PIECES = 4.0  # that fit, of a match: three people who walk along are three
GROUP_PIECES = 8.0  # more than a group of people about the robot
AS_WELL = 1.05  # factor in inliers within which two matches fit alike
IMPOSSIBLE = "faster than the robot can move"


class RegistrationConfig(BaseModel):
    """How a keyframe is registered to the ones before it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    references: int = Field(6, ge=1, description="keyframes matched against at once")
    good_pair_inlier_fraction: float = Field(
        0.7, ge=0, le=1, description="share of paired beams that must fit for a match without doubt"
    )
    false_alarm: float = Field(
        1e-4, gt=0, lt=1, description="probability of naming a fault where there is none"
    )
    good_inlier_fraction: float = Field(
        0.6,
        ge=0,
        le=1,
        description="share of known surface that fits, below which a search is made",
    )
    min_inlier_fraction: float = Field(
        0.4,
        ge=0,
        le=1,
        description="share of known surface that fits, below which a match is refused",
    )


class Hypothesis(NamedTuple):
    """A match, and how likely it is together with the motion that it would need."""

    start: str
    result: MatchResult
    seen: Agreement
    log_posterior: float  # nats, up to a constant


@dataclass(frozen=True, eq=False, slots=True)
class OdometryEvidence:
    """What the odometry says about the step to the new scan; poses are last_T_new."""

    prior: Prior  # the step and its covariance
    starts: Sequence[tuple[str, Pose2]]  # where else a match may start, by name
    possible: bool  # within the robot's speed limits
    reach: tuple[float, float]  # m and rad that the robot can move at most in that time
    fault_rate: float  # probability that the odometry of this step has a fault
    carried: float  # probability that the robot was carried elsewhere meanwhile


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """Outcome for one keyframe; poses are last_T_new."""

    result: MatchResult
    odometry_trusted: bool
    match_trusted: bool
    note: str  # what was refused and why; empty if nothing was
    # (3, 3) by which match and odometry are less certain than they seem: either may be wrong
    match_spread: NDArray[np.float64] | None = None
    odometry_spread: NDArray[np.float64] | None = None
    odds: float = -math.inf  # nats, of a fault of the odometry
    broken: bool = False  # nothing tells where the robot is now

    @property
    def lost(self) -> bool:
        """Neither source can be trusted."""
        return not (self.odometry_trusted or self.match_trusted)


# In place of a match that is not trusted.
NOTHING = MatchResult(
    Pose2(), np.zeros((3, 3)), np.eye(3), 0, 0.0, 0.0, 0.0, 0.0, None, math.inf, 0, False, ""
)


def disagreement(result: MatchResult, prior: Prior) -> float:
    """Squared Mahalanobis distance between match and prior, 3 degrees of freedom if both are right.

    The match's own information is used, so a direction that it does not see cannot disagree.
    """
    error = Pose2.Logmap(prior.target_T_source.between(result.target_T_source))
    return mahalanobis(error, prior.covariance, result.information)


def register(
    references: Sequence[Reference], scan: PreparedScan, odometry: OdometryEvidence,
    config: RegistrationConfig, matcher: MatchConfig,
) -> Registration:  # fmt: skip
    """Register a scan and decide what to trust, by the table above.

    Args:
        references: earlier keyframes, in the frame of the last one.
        scan: the new one.
        odometry: the step from the last keyframe, and other starts.
        config: thresholds.
        matcher: settings of the scan matcher.
    """
    return _Registrar(references, scan, odometry, config, matcher).decide()


@dataclass(frozen=True, eq=False, slots=True)
class _Registrar:
    """What one registration is made from."""

    references: Sequence[Reference]
    scan: PreparedScan
    odometry: OdometryEvidence
    config: RegistrationConfig
    matcher: MatchConfig

    def decide(self) -> Registration:
        prior = self.odometry.prior
        first = match(self.references, self.scan, prior.target_T_source, self.matcher, prior)
        right, alone = self._if_right(first), self._if_match_is_wrong()
        # What a match rests on may be all that moves along, where it is little.
        few = right.seen.fitting < GROUP_PIECES
        contradicted = few and alone.log_posterior > right.log_posterior + SURE_NATS
        if self._beyond_doubt(right) and not contradicted and self._checked_fault(right) is None:
            return Registration(first, True, True, "")
        faults = list(self._faults(right))
        fault = max(faults, key=lambda f: f.log_posterior, default=None)
        best = max(right.log_posterior, alone.log_posterior)
        odds = fault.log_posterior - best if fault else -math.inf
        if self._carried(right) > max(best, fault.log_posterior if fault else best) + SURE_NATS:
            return Registration(first, False, False, "the robot was carried", broken=True)
        if fault and odds > SURE_NATS and self._holds(fault):
            result = self._held(fault.result)
            cause = f"{odds:.0f} nats" if self.odometry.possible else IMPOSSIBLE
            note = f"odometry refused: {cause}; matched from {fault.start}"
            return Registration(result, False, True, note, odds=odds)
        if contradicted and fault and odds > -SURE_NATS and self._holds(fault):
            return self._undecided(alone, fault, odds)
        if self._holds(right) and self.odometry.possible and not contradicted:
            if fault is None or odds < -SURE_NATS:
                return Registration(first, True, True, "", odds=odds)
            return self._undecided(right, fault, odds)
        reason = right.result.reason or "too few pieces fit"
        reason = "what it fits has moved along" if contradicted else reason
        return Registration(first, self.odometry.possible, False, f"match refused: {reason}")

    def _undecided(self, right: Hypothesis, fault: Hypothesis, odds: float) -> Registration:
        """Both stay, each with the spread of two places of which either may be right.

        The match is the likelier one.
        """
        share = 1.0 / (1.0 + math.exp(-odds))
        told = self.odometry.prior.target_T_source
        found = fault if odds > 0.0 or right.result is NOTHING else right
        if_right = told if right.result is NOTHING else right.result.target_T_source
        here, if_fault = found.result.target_T_source, fault.result.target_T_source
        other = if_right if found is fault else if_fault
        off = Pose2.Logmap(here.between(other))
        slip = Pose2.Logmap(told.between(if_fault))
        return Registration(
            found.result, True, True, f"undecided: {odds:.1f} nats for a fault; {fault.start}",
            ((1.0 - share) if found is fault else share) * np.outer(off, off),
            share * np.outer(slip, slip), odds,
        )  # fmt: skip

    def _carried(self, right: Hypothesis) -> float:
        """Log posterior of a robot that was carried where none of the references looks."""
        pieces = right.seen.fitting + right.seen.new + right.seen.contradicting
        return math.log(self.odometry.carried) - NEW_NATS * pieces

    def _beyond_doubt(self, right: Hypothesis) -> bool:
        """Odometry and match agree, and the scan fits well."""
        return (
            self.odometry.possible
            and right.result.converged
            and disagreement(right.result, self.odometry.prior) < 2.0 * SURE_NATS
            and right.result.pair_inlier_fraction >= self.config.good_pair_inlier_fraction
            and right.seen.share >= self.config.good_inlier_fraction
            and right.seen.fitting >= LEAST_PIECES
        )

    def _holds(self, hypothesis: Hypothesis) -> bool:
        """Whether enough of the scan fits for the match to be one."""
        seen = hypothesis.seen
        enough = seen.fitting >= LEAST_PIECES and seen.share >= self.config.min_inlier_fraction
        return hypothesis.result.converged and enough

    def _if_right(self, result: MatchResult) -> Hypothesis:
        """The odometry is right, and the scan is where the match with it as a prior puts it."""
        log_prior = -0.5 * disagreement(result, self.odometry.prior)
        if not self.odometry.possible:
            log_prior = -math.inf
        return self._hypothesis("odometry", result, log_prior)

    def _if_match_is_wrong(self) -> Hypothesis:
        """The odometry is right to the point, whatever a match would say."""
        guess = self.odometry.prior.target_T_source
        seen = agreement(self.references, self.scan, guess, self.matcher)
        log_prior = 0.0 if self.odometry.possible else -math.inf
        return Hypothesis("odometry alone", NOTHING, seen, log_prior + seen.log_likelihood)

    def _if_fault(self, start: str, result: MatchResult) -> Hypothesis:
        """The odometry has a fault, and the scan is where a match from another start puts it."""
        log_fault = math.log(self.odometry.fault_rate)
        likely = self._any_motion(result.target_T_source)
        for name, guess in self.odometry.starts:
            if name in KNOWN_FAULTS:
                known = Prior(guess, self.odometry.prior.covariance)
                likely = max(likely, -0.5 * disagreement(result, known))
        return self._hypothesis(start, result, log_fault + likely)

    def _any_motion(self, last_T_new: Pose2) -> float:
        """Log density of a motion of which only the robot's limits are known.

        Against the most likely one if the odometry is right.
        """
        metres, radians = self.odometry.reach
        if math.hypot(last_T_new.x(), last_T_new.y()) > metres or abs(last_T_new.theta()) > radians:
            return -math.inf
        volume = math.pi * metres**2 * 2.0 * radians
        determinant = float(np.linalg.det(self.odometry.prior.covariance))
        return 0.5 * math.log((2.0 * math.pi) ** 3 * determinant) - math.log(volume)

    def _hypothesis(self, start: str, result: MatchResult, log_prior: float) -> Hypothesis:
        seen = agreement(self.references, self.scan, result.target_T_source, self.matcher)
        return Hypothesis(start, result, seen, log_prior + seen.log_likelihood)

    def _checked_fault(self, right: Hypothesis) -> Hypothesis | None:
        """A known kind of fault that explains the scan better, though odometry and match agree.

        A corridor looks alike a step further on: a match that starts where faulty odometry says can
        converge there and confirm it.  Most other starts end where the first match did, or fit
        worse, against the last keyframe alone: only the rest are worth the time of all references.
        """
        first, last = right.result, self.references[-1:]
        alone = self._near(first.target_T_source, last).inlier_fraction
        for name, guess in self.odometry.starts:
            if name not in KNOWN_FAULTS:
                continue
            other = self._near(guess, last)
            step = first.target_T_source.between(other.target_T_source)
            if not other.converged or math.hypot(step.x(), step.y()) < DISTINCT_M:
                continue
            if other.inlier_fraction < alone:
                continue
            fault = self._if_fault(name, self._near(guess, self.references))
            if fault.log_posterior > right.log_posterior - SURE_NATS:
                return fault
        return None

    def _near(self, guess: Pose2, among: Sequence[Reference]) -> MatchResult:
        """Match about a guess that is hardly more than a guess."""
        return match(among, self.scan, guess, self.matcher, Prior(guess, LOOSE_COVARIANCE))

    def _faults(self, right: Hypothesis) -> Iterator[Hypothesis]:
        """Matches without a prior, from the odometry and from every other start, then a search."""
        best = right.seen.share if right.result.converged else 0.0
        starts = [("odometry", self.odometry.prior.target_T_source), *self.odometry.starts]
        for name, guess in starts:
            result = self._match_last(guess)
            if result.converged:
                fault = self._if_fault(name, result)
                best = max(best, fault.seen.share)
                yield fault
        if best < self.config.good_inlier_fraction:
            for guess in searched_starts(self.references, self.scan, self.odometry.prior):
                result = self._match_last(guess)
                if result.converged:
                    yield self._if_fault("a search", result)

    def _match_last(self, guess: Pose2) -> MatchResult:
        """Match without a prior, first against the last keyframe alone.

        Older keyframes may stand wrong with respect to it; they join in if they agree.
        """
        alone = match(self.references[-1:], self.scan, guess, self.matcher)
        if not alone.converged or len(self.references) == 1:
            return alone
        seed = Prior(alone.target_T_source, JOINING_COVARIANCE)
        joint = match(self.references, self.scan, alone.target_T_source, self.matcher, seed)
        fits = joint.converged and (
            joint.pair_inlier_fraction >= self.config.good_pair_inlier_fraction
        )
        return joint if fits and joint.inlier_fraction >= alone.inlier_fraction else alone

    def _held(self, best: MatchResult) -> MatchResult:
        """The best match again, with the odometry as a wide prior, if it fits about as well.

        A direction that the scans do not see must not keep the place where the best start happened
        to be.
        """
        prior = self.odometry.prior
        doubted = Prior(prior.target_T_source, prior.covariance * DOUBT_INFLATION**2)
        held = match(self.references, self.scan, best.target_T_source, self.matcher, doubted)
        return held if held.inlier_fraction * AS_WELL >= best.inlier_fraction else best
