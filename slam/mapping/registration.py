"""Registers a scan to the keyframes before it, and decides between odometry and scan match.

The match starts where the odometry says.  If it agrees with the odometry, fits well, and no other
start fits clearly better, both are used.  Otherwise every start of `OdometryEvidence.starts` gives
a hypothesis, and after them a correlative search if all fit badly.  The hypothesis with the most
inliers wins; a later one must beat an earlier one by `margin`.  Then this table decides:

    | inliers of the best | odometry possible | agrees with it | match    | odometry |
    |---------------------|-------------------|----------------|----------|----------|
    | too few             | yes               | -              | refused  | used     |
    | too few             | no                | -              | refused  | refused  |
    | enough              | yes               | yes            | used     | used     |
    | enough              | yes               | no             | used     | refused  |
    | enough              | no                | -              | used     | refused  |

"Possible" is within the robot's speed limits; "agrees" is a chi-square test of the difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.chi_square import chi_square_limit, mahalanobis
from slam.frontend.correlative import CorrelativeConfig, Window, search, thin
from slam.frontend.loop_search import submap_points, target_field
from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan

# Faults that a match can confirm by mistake: motion of the wrong sign, motion where there is none,
# and none where there is.  Each has a start that would be right.
CHECKED_STARTS = ("mirrored translation", "zero motion", "previous velocity")
LOOSE_COVARIANCE = np.diag([0.3, 0.3, 0.2]) ** 2  # m, m, rad: hardly holds a match
LONGEST_STALL_S = 4.0  # s for which a robot may have gone on unseen; a wheel stall takes seconds
DISTINCT_M = 0.03  # m between the ends of two matches that are different hypotheses
DOUBT_INFLATION = 5.0  # factor on the sigmas of an odometry that does not look right
JOINING_COVARIANCE = np.diag([0.05, 0.05, 0.03]) ** 2  # m, m, rad: holds a pose found by one match
# The correlative search when all hypotheses fit badly: about the middle of the odometry's step.
SEARCH = CorrelativeConfig()
SEARCH_REFERENCES = 3  # last keyframes that it looks at
SEARCH_REACH_M = 1.0  # half width, beyond half of the step: a faulty step is off by its length
SEARCH_TURN_RAD = 0.8  # half width: more turn leaves little overlap at a view of 180 degrees
SEARCH_SCORE = 0.4  # least mean likelihood of a result; a wrong place scores 0.2 to 0.3


class RegistrationConfig(BaseModel):
    """How a keyframe is registered to the ones before it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    references: int = Field(6, ge=1, description="keyframes matched against at once")
    good_pair_inlier_fraction: float = Field(
        0.7, ge=0, le=1, description="share of paired beams that must fit for a match without doubt"
    )
    false_alarm: float = Field(
        1e-4, gt=0, lt=1, description="probability of refusing an odometry step without fault"
    )
    margin: float = Field(
        1.05, ge=1, description="factor in inliers by which another hypothesis must be better"
    )
    good_inlier_fraction: float = Field(
        0.45, ge=0, le=1, description="share of all beams that fit, below which a search is made"
    )
    min_inlier_fraction: float = Field(
        0.25, ge=0, le=1, description="share of all beams that fit, below which a match is refused"
    )


class Hypothesis(NamedTuple):
    """A match and the start that led to it."""

    start: str
    result: MatchResult

    @property
    def inlier_fraction(self) -> float:
        """Share of all beams that fit; 0 if the match did not converge."""
        return self.result.inlier_fraction if self.result.converged else 0.0


@dataclass(frozen=True, eq=False, slots=True)
class OdometryEvidence:
    """What the odometry says about the step to the new scan; poses are last_T_new."""

    prior: Prior  # the step and its covariance
    starts: Sequence[tuple[str, Pose2]]  # where else a match may start, by name
    possible: bool  # within the robot's speed limits
    continues: bool  # in the direction of the last step


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """Outcome for one keyframe; poses are last_T_new."""

    result: MatchResult
    odometry_trusted: bool
    match_trusted: bool
    note: str  # what was refused and why; empty if nothing was

    @property
    def lost(self) -> bool:
        """Neither source can be trusted."""
        return not (self.odometry_trusted or self.match_trusted)


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
    limit = chi_square_limit(config.false_alarm, 3)
    prior = odometry.prior
    first = match(references, scan, prior.target_T_source, matcher, prior)
    agrees = first.converged and disagreement(first, prior) < limit
    if odometry.possible and agrees and _fits_well(first, config):
        if not _other_start_fits_better(first, references, scan, odometry, config, matcher):
            return Registration(first, True, True, "")
    best = Hypothesis("odometry", first)
    for other in _hypotheses(references, scan, odometry, config, matcher):
        if other.inlier_fraction > config.margin * best.inlier_fraction:
            best = other
    if best.inlier_fraction < config.good_inlier_fraction:
        for guess in _searched(references, scan, prior):
            other = Hypothesis("a search", _match_last(references, scan, guess, matcher, config))
            if other.inlier_fraction > config.margin * best.inlier_fraction:
                best = other
    if best.inlier_fraction < config.min_inlier_fraction:
        reason = best.result.reason or "too few beams fit"
        return Registration(best.result, odometry.possible, False, f"match refused: {reason}")
    result = _held(best.result, references, scan, prior, config, matcher)
    distance = disagreement(result, prior)
    if odometry.possible and distance < limit:
        return Registration(result, True, True, "")
    cause = f"chi-square {distance:.0f}" if odometry.possible else "faster than the robot can move"
    note = f"odometry refused: {cause}; matched from {best.start}"
    return Registration(result, False, True, note)


def starts_in_doubt(
    moved: Pose2, seconds: float, last_step: tuple[Pose2, float] | None
) -> list[tuple[str, Pose2]]:
    """Where else to start a match when the odometry's step `moved` looks wrong, by name.

    `last_step` is the motion to the last keyframe and how long (s) it took, if there was one.
    """
    starts = [
        ("zero motion", Pose2()),
        ("mirrored translation", Pose2(-moved.x(), -moved.y(), moved.theta())),
        ("turn only", Pose2(0.0, 0.0, moved.theta())),
        ("translation only", Pose2(moved.x(), moved.y(), 0.0)),
    ]
    if last_step is not None:
        step, duration = last_step
        share = min(seconds, LONGEST_STALL_S) / max(duration, 1e-3)
        starts.append(("previous velocity", Pose2.Expmap(share * Pose2.Logmap(step))))
    return starts


def _fits_well(result: MatchResult, config: RegistrationConfig) -> bool:
    return (
        result.pair_inlier_fraction >= config.good_pair_inlier_fraction
        and result.inlier_fraction >= config.good_inlier_fraction
    )


def _other_start_fits_better(
    first: MatchResult, references: Sequence[Reference], scan: PreparedScan,
    odometry: OdometryEvidence, config: RegistrationConfig, matcher: MatchConfig,
) -> bool:  # fmt: skip
    """Whether another start fits the scan clearly better, though odometry and match agree.

    A corridor looks alike a step further on: a match that starts where faulty odometry says can
    converge there and confirm it.  Most other starts end where the first match did, or fit worse,
    against the last keyframe alone: only the rest are worth the time of all references.
    """

    def found(guess: Pose2, among: Sequence[Reference]) -> Hypothesis:
        return Hypothesis("", match(among, scan, guess, matcher, Prior(guess, LOOSE_COVARIANCE)))

    last = references[-1:]
    alone = found(first.target_T_source, last).inlier_fraction
    for name, guess in odometry.starts:
        if name not in CHECKED_STARTS:
            continue
        other = found(guess, last)
        step = first.target_T_source.between(other.result.target_T_source)
        if np.hypot(step.x(), step.y()) < DISTINCT_M or other.inlier_fraction < alone:
            continue
        unseen = 0.0
        if odometry.continues:
            unseen = _unseen_share(references, scan, first.target_T_source)
        needed = config.margin * (first.inlier_fraction + unseen)
        if found(guess, references).inlier_fraction > needed:
            return True
    return False


def _unseen_share(references: Sequence[Reference], scan: PreparedScan, last_T_scan: Pose2) -> float:
    """Share of the scan's beams that end where no reference has looked.

    A robot that backs away sees walls that were behind it: that none of the scans before knows
    them does not speak against the motion.
    """
    points = scan.points[np.isfinite(scan.points).all(axis=1)]
    unseen = np.ones(len(points), dtype=bool)
    for reference in references:
        first, step, x, y = reference.scan.geometry[:4]
        here = reference.target_T_scan.between(last_T_scan).transformFrom(points.T).T - (x, y)
        turn = np.mod(np.arctan2(here[:, 1], here[:, 0]) - first, 2.0 * np.pi)
        unseen &= turn > step * (len(reference.scan.points) - 1)
    return float(np.mean(unseen)) if len(points) else 0.0


def _hypotheses(
    references: Sequence[Reference], scan: PreparedScan, odometry: OdometryEvidence,
    config: RegistrationConfig, matcher: MatchConfig,
) -> Iterator[Hypothesis]:  # fmt: skip
    """Matches without a prior, from the odometry and from every other start."""
    for name, guess in [("odometry", odometry.prior.target_T_source), *odometry.starts]:
        yield Hypothesis(name, _match_last(references, scan, guess, matcher, config))


def _match_last(
    references: Sequence[Reference], scan: PreparedScan, guess: Pose2, matcher: MatchConfig,
    config: RegistrationConfig,
) -> MatchResult:  # fmt: skip
    """Match without a prior, first against the last keyframe alone.

    Older keyframes may stand wrong with respect to it; they join in if they agree.
    """
    alone = match(references[-1:], scan, guess, matcher)
    if not alone.converged or len(references) == 1:
        return alone
    seed = Prior(alone.target_T_source, JOINING_COVARIANCE)
    joint = match(references, scan, alone.target_T_source, matcher, seed)
    fits = joint.converged and joint.pair_inlier_fraction >= config.good_pair_inlier_fraction
    return joint if fits and joint.inlier_fraction >= alone.inlier_fraction else alone


def _searched(references: Sequence[Reference], scan: PreparedScan, prior: Prior) -> list[Pose2]:
    """Where a correlative search about the last keyframe and the odometry's step finds the scan."""
    last = references[-SEARCH_REFERENCES:]
    field = target_field([(r.target_T_scan, r.scan) for r in last], SEARCH)
    cloud = submap_points([(Pose2(), scan)])
    near = np.hypot(cloud[:, 0], cloud[:, 1]) < SEARCH.max_range
    points = thin(cloud[near], SEARCH.resolution, SEARCH.max_points)
    moved = prior.target_T_source
    reach = SEARCH_REACH_M + 0.5 * float(np.hypot(moved.x(), moved.y()))
    halfway = Pose2(0.5 * moved.x(), 0.5 * moved.y(), moved.theta())
    found = search(field, points, Window(halfway, reach, SEARCH_TURN_RAD), SEARCH_SCORE)
    return [] if found is None else [found.target_T_query]


def _held(
    best: MatchResult, references: Sequence[Reference], scan: PreparedScan, prior: Prior,
    config: RegistrationConfig, matcher: MatchConfig,
) -> MatchResult:  # fmt: skip
    """The best match again, with the odometry as a wide prior, if it fits about as well.

    A direction that the scans do not see must not keep the place where the best start happened to
    be.
    """
    doubted = Prior(prior.target_T_source, prior.covariance * DOUBT_INFLATION**2)
    held = match(references, scan, best.target_T_source, matcher, doubted)
    return held if held.inlier_fraction * config.margin >= best.inlier_fraction else best
