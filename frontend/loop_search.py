"""Loop candidates: is this the place where the robot was long ago, and exactly where in it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from slam.frontend.agreement import agreement
from slam.frontend.correlative import (
    CorrelativeConfig,
    Found,
    LikelihoodField,
    Window,
    build_field,
    search,
    thin,
)
from slam.frontend.loop_axes import without_degenerate_direction
from slam.frontend.match_types import MatchConfig, MatchResult, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import VALID, PreparedScan

Matrix = NDArray[np.float64]

# m from a place to where a query may stand: the search window, and what lies between the keyframes
# of one place.  Farther than this beyond the query's range its field holds nothing of use.
FIELD_MARGIN_M = 10.0
# Pieces of surface that must fit.  A piece fits by chance at one wrong place in three, which six
# do at one in seven hundred; and a group of people is fewer than that.
CLOSURE_PIECES = 6.0


class LoopSearchConfig(BaseModel):
    """Verification of a loop candidate."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    correlative: CorrelativeConfig = CorrelativeConfig()
    min_score: float = Field(0.45, ge=0, le=1, description="of the correlative search")
    ambiguity_ratio: float = Field(
        0.92,
        gt=0,
        le=1,
        description="a second place that scores this share of the best is ambiguous",
    )
    min_pair_inlier_fraction: float = Field(
        0.6, ge=0, le=1, description="share of paired beams that must fit"
    )
    min_fit: float = Field(
        0.55, ge=0, le=1, description="mean likelihood of the query at the result"
    )
    max_reach: float = Field(4.0, gt=0, description="m, the search window never grows beyond")
    max_turn: float = Field(0.6, gt=0, description="rad, the search window never turns beyond")


@dataclass(frozen=True, eq=False, slots=True)
class Closure:
    """A candidate after the search; `reason` is empty if nothing spoke against it."""

    # The refined match; along its `degenerate_direction`, if any, it knows nothing.
    result: MatchResult | None
    score: float
    second_score: float
    reason: str


def submap_points(scans: Sequence[tuple[Pose2, PreparedScan]]) -> Matrix:
    """All valid points of some scans in one frame, (n, 2); poses are frame_T_scan."""
    parts = []
    for pose, scan in scans:
        points = scan.points[(scan.flags & VALID) > 0]
        parts.append(pose.transformFrom(np.asfortranarray(points.T)).T)
    return np.concatenate(parts)


def target_field(
    scans: Sequence[tuple[Pose2, PreparedScan]], config: CorrelativeConfig
) -> LikelihoodField:
    """Likelihood field of some old keyframes in the frame of one of them."""
    points = submap_points(scans)
    near = np.hypot(points[:, 0], points[:, 1]) < config.max_range + FIELD_MARGIN_M
    return build_field(np.ascontiguousarray(points[near]), config)


def close_loop(
    field: LikelihoodField,
    references: Sequence[Reference],
    query: Sequence[tuple[Pose2, PreparedScan]],
    predicted: Pose2,
    covariance: Matrix,
    config: LoopSearchConfig,
    matcher: MatchConfig,
) -> Closure:
    """Search, refine and judge one candidate.

    Args:
        field: of the old place, in the frame of its anchor keyframe.
        references: the old keyframes, in the anchor's frame.
        query: the last keyframes, in the frame of the newest, which comes last.
        predicted: anchor_T_newest as the graph has it.
        covariance: of that prediction, in the newest's frame.
        config: thresholds.
        matcher: of the scan matcher.
    """
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    sigma_turn = float(np.sqrt(covariance[2, 2]))
    reach = min(3 * sigma + 0.3, config.max_reach)
    window = Window(predicted, reach, min(3 * sigma_turn + 0.1, config.max_turn))
    cloud = submap_points(query)
    near = np.hypot(cloud[:, 0], cloud[:, 1]) < config.correlative.max_range
    points = thin(cloud[near], config.correlative.resolution, config.correlative.max_points)
    found = search(field, points, window, config.min_score)
    if found is None:
        return Closure(None, 0.0, 0.0, "no pose in the window explains the scan")
    return _refine(found, field, points, references, query[-1][1], predicted, config, matcher)


def _refine(
    found: Found, field: LikelihoodField, points: Matrix, references: Sequence[Reference],
    newest: PreparedScan, predicted: Pose2, config: LoopSearchConfig, matcher: MatchConfig,
) -> Closure:  # fmt: skip
    seed = Prior(found.target_T_query, np.diag([0.1**2, 0.1**2, 0.03**2]))
    result = match(references, newest, found.target_T_query, matcher, seed)
    score, second = found.score, found.second_score
    if not result.converged:
        return Closure(None, score, second, f"match refused: {result.reason}")
    if result.pair_inlier_fraction < config.min_pair_inlier_fraction:
        return Closure(
            result, score, second, f"only {100 * result.pair_inlier_fraction:.0f} % of beams fit"
        )
    seen = agreement(references, newest, result.target_T_source, matcher)
    if seen.fitting < CLOSURE_PIECES:
        return Closure(result, score, second, f"only {seen.fitting:.0f} pieces of surface fit")
    fit = likelihood_at(field, points, result.target_T_source)
    if fit < config.min_fit:
        return Closure(result, fit, second, f"mean likelihood {fit:.2f} is too low")
    if second > config.ambiguity_ratio * score:
        return Closure(result, fit, second, "another place in the window fits as well")
    return Closure(
        without_degenerate_direction(result, _anchor(references), newest, predicted),
        fit,
        second,
        "",
    )


def _anchor(references: Sequence[Reference]) -> PreparedScan:
    """The scan whose frame is that of the references."""
    return min(
        references, key=lambda r: float(np.hypot(r.target_T_scan.x(), r.target_T_scan.y()))
    ).scan


def likelihood_at(field: LikelihoodField, points: Matrix, target_T_query: Pose2) -> float:
    """Mean likelihood (0 to 1) of query points (n, 2) at a pose."""
    placed = target_T_query.transformFrom(np.asfortranarray(points.T)).T
    cells = np.floor((placed - field.origin) / field.resolution).astype(np.int64)
    rows, columns = field.levels.shape[1:]
    inside = (
        (cells[:, 0] >= 0) & (cells[:, 0] < columns) & (cells[:, 1] >= 0) & (cells[:, 1] < rows)
    )
    values = field.levels[0][cells[inside, 1], cells[inside, 0]]
    return float(values.sum()) / len(points)
