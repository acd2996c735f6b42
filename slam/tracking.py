"""Keyframe to keyframes: the odometry's word against the match's, neither believed blindly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field
from scipy.stats import chi2

from frontend.matching import MatchConfig, MatchResult, Prior, Reference, match
from frontend.scan import PreparedScan


class TrackingConfig(BaseModel):
    """When a match of neighbouring keyframes is believed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    references: int = Field(6, ge=1, description="keyframes matched against at once")
    good_explained: float = Field(
        0.7, ge=0, le=1, description="share of beams that must fit for a match without doubts"
    )
    false_alarm: float = Field(
        1e-4, gt=0, lt=1, description="how often honest odometry may be called a liar"
    )
    margin: float = Field(
        1.05, ge=1, description="by how much another start must explain the scan better"
    )
    min_quality: float = Field(
        0.25, ge=0, le=1, description="share of beams paired and explained, below which all is lost"
    )


@dataclass(frozen=True, eq=False, slots=True)
class Tracked:
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
    # (C_prior + C_match)^-1 = P - P (P + I)^-1 P, which needs no inverse of a blind match.
    known = np.linalg.inv(prior.covariance)
    weight = known - known @ np.linalg.solve(known + result.information, known)
    return float(error @ weight @ error)


def quality(result: MatchResult) -> float:
    """Share of the beams that were paired and fit; 0 for a refused match."""
    return result.explained * result.overlap if result.converged else 0.0


def track(
    references: Sequence[Reference],
    source: PreparedScan,
    prior: Prior,
    alternatives: Sequence[tuple[str, Pose2]],
    plausible: bool,
    config: TrackingConfig,
    matcher: MatchConfig,
) -> Tracked:
    """Match a keyframe against the ones before it, from several starts if the first disappoints.

    Args:
        references: earlier keyframes, in the frame of the last one.
        source: the new scan.
        prior: the odometry's step from the last keyframe.
        alternatives: other starting points by name, tried when odometry looks wrong.
        plausible: whether the odometry's step is one that the robot can make.
        config: thresholds.
        matcher: of the scan matcher.
    """
    limit = chi2.isf(config.false_alarm, 3)
    first = match(references, source, prior.target_T_source, matcher, prior)
    agreed = first.converged and disagreement(first, prior) < limit
    if plausible and agreed and first.explained >= config.good_explained:
        return Tracked(first, True, True, "")
    best, start = first, "odometry"
    for name, guess in alternatives:
        other = match(references, source, guess, matcher)
        if quality(other) > config.margin * quality(best):
            best, start = other, name
    if quality(best) < config.min_quality:
        note = f"match refused: {best.reason or 'too few beams explained'}"
        return Tracked(best, plausible, False, note)
    distance = disagreement(best, prior)
    if plausible and distance < limit:
        return Tracked(best, True, True, "")
    cause = f"chi-square {distance:.0f}" if plausible else "faster than the robot can move"
    return Tracked(best, False, True, f"odometry refused: {cause}; matched from {start}")
