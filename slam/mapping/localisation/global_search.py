"""Finds where in a map a scan may have been taken when nothing, or little, is known of that."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from gtsam import Pose2

from slam.frontend.match_types import MatchConfig, Prior
from slam.frontend.matching import match
from slam.frontend.pose_search import PoseField, likely_poses, pose_field
from slam.frontend.scan import VALID, PreparedScan
from slam.mapping.localisation.evidence import scan_evidence
from slam.mapping.localisation.fixed_map import FixedMap
from slam.mapping.localisation.hypothesis import Hypothesis, holds

REACH_M = 2.0  # m from where the map was driven: a robot is seldom anywhere else
CANDIDATES = 60  # poses that are matched
RANGE_M = 20.0  # m, what keyframes see beyond is too coarse to stand in the field
GIVEN_LOG_ODDS = 5.0  # of a start that is given: one in a hundred is mistaken
SEED = np.diag([0.2, 0.2, 0.1]) ** 2  # m, m, rad: how far off a candidate may be
START_M, START_RAD = 1.5, 0.6  # by how much a given start may be off
NEARBY_M = 2.0  # m from where it was lost that a robot is looked for first
# A robot that is lost is more often near by, for its wheels have slipped, than carried away.
NEARBY_LOG_ODDS = 3.0


class GlobalSearch:
    """The field of a map, made at the first search."""

    def __init__(self, fixed_map: FixedMap, count: int, matcher: MatchConfig) -> None:
        self._map, self._count, self._matcher = fixed_map, count, matcher
        self._field: PoseField | None = None

    def __call__(self, scan: PreparedScan, start: Pose2 | None = None) -> list[Hypothesis]:
        """Poses anywhere, or about `start` (map_T_base), the likeliest one first."""
        if start is None:
            return self._found(scan, self._whole(), 0.0)
        field = self._whole().about(start.x(), start.y(), START_M)
        return self._found(scan, field, GIVEN_LOG_ODDS, start.theta(), START_RAD)

    def nearby(self, scan: PreparedScan, here: Pose2) -> list[Hypothesis]:
        """Poses about the one (map_T_base) where the robot was lost, at any heading."""
        field = self._whole().about(here.x(), here.y(), NEARBY_M)
        return self._found(scan, field, NEARBY_LOG_ODDS)

    def _found(
        self, scan: PreparedScan, field: PoseField, log_prior: float, heading: float = 0.0,
        turn: float = math.pi,
    ) -> list[Hypothesis]:  # fmt: skip
        points = scan.points[(scan.flags & VALID) > 0]
        candidates = likely_poses(field, points, CANDIDATES, heading, turn)
        found = [self._judged(scan, c.map_T_base) for c in candidates]
        sound = sorted((h for h in found if h is not None), key=lambda h: -h.mean_evidence)
        return _with_odds(different(sound), log_prior)

    def _whole(self) -> PoseField:
        if self._field is None:
            self._field = pose_field(self._map.points(RANGE_M), self._map.at[:, :2], REACH_M)
        return self._field

    def _judged(self, scan: PreparedScan, pose: Pose2) -> Hypothesis | None:
        base, references = self._map.near(scan, pose, self._count)
        prior = Prior(base.between(pose), SEED)
        result = match(references, scan, prior.target_T_source, self._matcher, prior)
        if not result.converged:
            return None
        seen = self._map.seen(scan, base * result.target_T_source, self._matcher)
        if not holds(result, seen):
            return None
        return Hypothesis(pose, SEED, 0.0, scan_evidence(seen)).at(base, result)


def _with_odds(found: list[Hypothesis], log_prior: float) -> list[Hypothesis]:
    """Poses of a search with their log odds.

    Each of them, and a robot that is elsewhere, is as likely as the others before the scan is
    looked at; that a search takes what fits best is in the evidence already, whose wrong poses
    were found by searches.
    """
    log_odds = log_prior - math.log(len(found) + 1.0)
    return [replace(h, log_odds=log_odds + h.mean_evidence) for h in found]


def different(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Without those that have come to where an earlier one is."""
    kept: list[Hypothesis] = []
    for one in hypotheses:
        if not any(same_place(one.pose, other.pose) for other in kept):
            kept.append(one)
    return kept


SAME_M, SAME_RAD = 0.25, 0.1  # nearer ones are the same place


def same_place(a: Pose2, b: Pose2) -> bool:
    """Whether two poses are one, but for the error of their matches."""
    error = a.between(b)
    return math.hypot(error.x(), error.y()) < SAME_M and abs(error.theta()) < SAME_RAD
