"""Keyframe to keyframes: the odometry's word against the match's, neither believed blindly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.chi_square import chi_square_limit, mahalanobis
from slam.frontend.correlative import CorrelativeConfig, Window, search, thin
from slam.frontend.loop_search import submap_points, target_field
from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan

# The lies that look true: motion of the wrong sign, motion where there is none, and none where
# there is; each with a start that would be right.
ALTERNATIVE_STARTS = ("mirrored translation", "zero motion", "previous velocity")
ALTERNATIVE_COVARIANCE = np.diag([0.3, 0.3, 0.2]) ** 2  # m, m, rad: hardly holds the match
GOES_ON_S = 4.0  # s for which a robot may have gone on as it did before; a stall takes seconds
APART_M = 0.03  # m between the ends of two matches that are not the same

DOUBT = 5.0  # factor on the sigmas of an odometry that does not look right


class RegistrationConfig(BaseModel):
    """When a match of neighbouring keyframes is believed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    references: int = Field(6, ge=1, description="keyframes matched against at once")
    good_pair_inlier_fraction: float = Field(
        0.7, ge=0, le=1, description="share of beams that must fit for a match without doubts"
    )
    false_alarm: float = Field(
        1e-4, gt=0, lt=1, description="how often honest odometry may be called a liar"
    )
    search: CorrelativeConfig = CorrelativeConfig()
    search_reach: float = Field(1.0, gt=0, description="m, half width of the search when in doubt")
    search_turn: float = Field(0.8, gt=0, description="rad, likewise")
    search_score: float = Field(0.4, ge=0, le=1, description="least mean likelihood of such a find")
    margin: float = Field(
        1.05, ge=1, description="by how much another start must explain the scan better"
    )
    good_inlier_fraction: float = Field(
        0.45, ge=0, le=1, description="share of beams paired and explained, below which to search"
    )
    min_inlier_fraction: float = Field(
        0.25, ge=0, le=1, description="share of beams paired and explained, below which all is lost"
    )


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

    The match's own information is used, so an axis it cannot see cannot disagree.
    """
    error = Pose2.Logmap(prior.target_T_source.between(result.target_T_source))
    return mahalanobis(error, prior.covariance, result.information)


def register(
    references: Sequence[Reference],
    source: PreparedScan,
    prior: Prior,
    alternatives: Sequence[tuple[str, Pose2]],
    plausible: bool,
    goes_on: bool,
    config: RegistrationConfig,
    matcher: MatchConfig,
) -> Registration:
    """Match a keyframe against the ones before it, from several starts if the first disappoints.

    Args:
        references: earlier keyframes, in the frame of the last one.
        source: the new scan.
        prior: the odometry's step from the last keyframe.
        alternatives: other starting points by name, tried when odometry looks wrong.
        plausible: whether the odometry's step is one that the robot can make.
        goes_on: whether it leads the way that the robot went before.
        config: thresholds.
        matcher: of the scan matcher.
    """
    limit = chi_square_limit(config.false_alarm, 3)
    first = match(references, source, prior.target_T_source, matcher, prior)
    agreed = first.converged and disagreement(first, prior) < limit
    good = (
        first.pair_inlier_fraction >= config.good_pair_inlier_fraction
        and first.inlier_fraction >= config.good_inlier_fraction
    )
    if plausible and agreed and good:
        if not _beaten_by_alternative(
            first, references, source, alternatives, goes_on, config, matcher
        ):
            return Registration(first, True, True, "")
    best, start = first, "odometry"
    for name, guess in [("odometry", prior.target_T_source), *alternatives]:
        other = _match_last(references, source, guess, matcher, config)
        if _inlier_fraction(other) > config.margin * _inlier_fraction(best):
            best, start = other, name
    if _inlier_fraction(best) < config.good_inlier_fraction:
        for guess in _searched(references, source, prior, config):
            other = _match_last(references, source, guess, matcher, config)
            if _inlier_fraction(other) > config.margin * _inlier_fraction(best):
                best, start = other, "a search"
    if _inlier_fraction(best) < config.min_inlier_fraction:
        note = f"match refused: {best.reason or 'too few beams pair_inlier_fraction'}"
        return Registration(best, plausible, False, note)
    # An axis that the scans do not see must not keep the place of whatever start was the best.
    odometry_faulty = Prior(prior.target_T_source, prior.covariance * DOUBT**2)
    held = match(references, source, best.target_T_source, matcher, odometry_faulty)
    if held.inlier_fraction * config.margin >= best.inlier_fraction:
        best = held
    distance = disagreement(best, prior)
    if plausible and distance < limit:
        return Registration(best, True, True, "")
    cause = f"chi-square {distance:.0f}" if plausible else "faster than the robot can move"
    return Registration(best, False, True, f"odometry refused: {cause}; matched from {start}")


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
        share = min(seconds, GOES_ON_S) / max(duration, 1e-3)
        starts.append(("previous velocity", Pose2.Expmap(share * Pose2.Logmap(step))))
    return starts


def _beaten_by_alternative(
    first: MatchResult, references: Sequence[Reference], source: PreparedScan,
    alternatives: Sequence[tuple[str, Pose2]], goes_on: bool, config: RegistrationConfig,
    matcher: MatchConfig,
) -> bool:  # fmt: skip
    """Whether another start explains the scan clearly better, though odometry and match agree.

    A corridor looks alike a step further on: a match that starts where lying odometry says can
    settle there and confirm it.  Most rivals end where the first match did, or fit worse, against
    the last keyframe alone: only the others are worth the time of all references.
    """

    def found(guess: Pose2, among: Sequence[Reference]) -> MatchResult:
        return match(among, source, guess, matcher, Prior(guess, ALTERNATIVE_COVARIANCE))

    last = references[-1:]
    alone = _inlier_fraction(found(first.target_T_source, last))
    for name, guess in alternatives:
        if name not in ALTERNATIVE_STARTS:
            continue
        other = found(guess, last)
        step = first.target_T_source.between(other.target_T_source)
        if np.hypot(step.x(), step.y()) < APART_M or _inlier_fraction(other) < alone:
            continue
        unseen = _unseen(references, source, first.target_T_source) if goes_on else 0.0
        if _inlier_fraction(found(guess, references)) > config.margin * (
            first.inlier_fraction + unseen
        ):
            return True
    return False


def _unseen(references: Sequence[Reference], source: PreparedScan, pose: Pose2) -> float:
    """Share of the scan's beams that end where no reference has looked, at target_T_source.

    A robot that backs away sees walls that were behind it: that none of the scans before knows
    them does not speak against the motion.
    """
    points = source.points[np.isfinite(source.points).all(axis=1)]
    unseen = np.ones(len(points), dtype=bool)
    for reference in references:
        first, step, x, y = reference.scan.geometry[:4]
        here = reference.target_T_scan.between(pose).transformFrom(points.T).T - (x, y)
        turn = np.mod(np.arctan2(here[:, 1], here[:, 0]) - first, 2.0 * np.pi)
        unseen &= turn > step * (len(reference.scan.points) - 1)
    return float(np.mean(unseen)) if len(points) else 0.0


def _inlier_fraction(result: MatchResult) -> float:
    return result.inlier_fraction if result.converged else 0.0


def _match_last(
    references: Sequence[Reference], source: PreparedScan, guess: Pose2, matcher: MatchConfig,
    config: RegistrationConfig,
) -> MatchResult:  # fmt: skip
    """Match without a prior, first against the last keyframe alone.

    Older keyframes may stand wrong with respect to it; they join in if they agree.
    """
    alone = match(references[-1:], source, guess, matcher)
    if not alone.converged or len(references) == 1:
        return alone
    seed = Prior(alone.target_T_source, np.diag([0.05, 0.05, 0.03]) ** 2)
    joint = match(references, source, alone.target_T_source, matcher, seed)
    good = joint.converged and joint.pair_inlier_fraction >= config.good_pair_inlier_fraction
    return joint if good and joint.inlier_fraction >= alone.inlier_fraction else alone


def _searched(
    references: Sequence[Reference], source: PreparedScan, prior: Prior, config: RegistrationConfig
) -> list[Pose2]:
    """Where a correlative search about the last keyframe and the odometry's step finds the scan."""
    field = target_field([(r.target_T_scan, r.scan) for r in references[-3:]], config.search)
    cloud = submap_points([(Pose2(), source)])
    near = np.hypot(cloud[:, 0], cloud[:, 1]) < config.search.max_range
    points = thin(cloud[near], config.search.resolution, config.search.max_points)
    moved = prior.target_T_source
    reach = config.search_reach + 0.5 * float(np.hypot(moved.x(), moved.y()))
    halfway = Pose2(0.5 * moved.x(), 0.5 * moved.y(), moved.theta())
    found = search(field, points, Window(halfway, reach, config.search_turn), config.search_score)
    return [] if found is None else [found.target_T_query]
