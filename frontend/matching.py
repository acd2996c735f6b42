"""`match`: the motion between scans, by point-to-line ICP against several references at once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np
from gtsam import Pose2
from slam.frontend.align_kernels import align
from slam.frontend.alternative_matchers import find_pose
from slam.frontend.degeneracy import is_degenerate
from slam.frontend.match_types import (
    TOLERANCE_M,
    MatchConfig,
    MatchResult,
    Matrix,
    Prior,
    Reference,
    Triple,
)
from slam.frontend.scan import PreparedScan

# An iteration that still swings by a few tolerances stands well within the bias floor.
CONVERGED_TOLERANCES = 10.0

# Other starts about a guess that nothing supports: turned, or moved along or across.
OTHER_STARTS = np.array(
    [
        *((0.0, 0.0, turn) for turn in (0.21, -0.21, 0.42, -0.42)),
        *((x, y, 0.0) for x, y in ((0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4))),
    ]
)
NO_STARTS = np.empty((0, 3))

_NO_INFORMATION = np.zeros((3, 3))
# In place of a missing prior: 1 m and 1 rad carry no information but keep matrices regular.
_IGNORANCE = np.eye(3)


def match(
    references: Sequence[Reference],
    source: PreparedScan,
    guess: Pose2,
    config: MatchConfig,
    prior: Prior | None = None,
) -> MatchResult:
    """Align `source` to all references at once, starting from `guess` (target_T_source).

    A refused match is an outcome: `converged` is False and `reason` says why; the pose is then
    the guess.  With a prior, a direction that the scans do not constrain keeps the prior's value.
    """
    start = guess.x(), guess.y(), guess.theta()
    if not math.isfinite(sum(start)):
        return _refused(guess, prior, "the guess is not finite")
    stacked = stack_references(references)
    if source.valid < config.min_pairs:
        return _refused(guess, prior, f"only {source.valid} usable beams")
    if stacked is None:
        return _refused(guess, prior, "no reference has usable beams")
    if config.method != "point_to_line":
        return _alternative(references, stacked, source, guess, start, config, prior)
    passes = config.passes_without_prior if prior is None else config.passes_with_prior
    others = OTHER_STARTS if prior is None else NO_STARTS
    return _align(stacked, source, guess, start, passes, others, config, prior)


def _alternative(
    references: Sequence[Reference], stack: tuple[Any, ...], source: PreparedScan, guess: Pose2,
    start: Triple, config: MatchConfig, prior: Prior | None,
) -> MatchResult:  # fmt: skip
    """The pose by another method, judged by the lines at that pose.

    Their own closed-form covariances are wrong (point-to-point: Bonnabel 2014), so the
    information is what the best of matches could have: an upper bound.
    """
    pose, last_step, iterations = find_pose(references, stack, source, np.array(start), config)
    if not np.isfinite(last_step) or not np.isfinite(pose).all():
        return _refused(guess, prior, f"{config.method} found no pose")
    found = Pose2(*pose)
    at = found.x(), found.y(), found.theta()
    last_pass = config.passes_with_prior[-1:]
    judged = _align(stack, source, found, at, last_pass, NO_STARTS, config, prior)
    if last_step > CONVERGED_TOLERANCES * TOLERANCE_M:
        reason = f"no convergence in {iterations} iterations"
        return judged._replace(
            target_T_source=found, iterations=iterations, converged=False, reason=reason
        )
    return judged._replace(target_T_source=found, iterations=iterations)


def _align(
    stack: tuple[Any, ...], source: PreparedScan, guess: Pose2, start: Triple, passes: Matrix,
    others: Matrix, config: MatchConfig, prior: Prior | None,
) -> MatchResult:  # fmt: skip
    """Align by point-to-line ICP from the guess, and from `others` about it if that goes badly.

    `start` holds the guess as (x, y, theta): to ask a pose for them takes as long as all of this.
    """
    known, centre = _IGNORANCE, start
    if prior is not None:
        # Of another memory layout, all kernels would be compiled anew.
        known, at = np.ascontiguousarray(prior.covariance), prior.target_T_source
        centre = start if at is guess else (at.x(), at.y(), at.theta())
    (
        x, y, theta, information, covariance, last_step, iterations, axis, condition_ratio,
        pairs, inliers, paired, fitting, tried, cost, weight,
    ) = align(
        (source.points, source.lines, source.flags, source.geometry), stack, start,
        (centre, known, prior is not None), passes, others, config.limits,
    )  # fmt: skip
    if pairs < config.min_pairs:
        return _refused(guess, prior, f"only {pairs} pairs")
    pair_inlier_fraction = inliers / pairs
    reason = ""
    if last_step > CONVERGED_TOLERANCES * TOLERANCE_M:
        reason = f"no convergence in {iterations} iterations"
    elif pair_inlier_fraction < config.min_pair_inlier_fraction:
        reason = f"only {100 * pair_inlier_fraction:.0f} % of the pairs fit"
    return MatchResult(
        Pose2(x, y, theta), information, covariance, pairs, pair_inlier_fraction, paired / tried,
        fitting / tried, math.sqrt(cost / weight), axis if is_degenerate(condition_ratio) else None,
        condition_ratio, iterations, not reason, reason,
    )  # fmt: skip


def stack_references(references: Sequence[Reference]) -> tuple[Any, ...] | None:
    """The references end to end: the fields of `match_arrays.References`."""
    used = [r for r in references if r.scan.valid > 2]
    if not used:
        return None
    first = used[0].scan
    if len(used) == 1:
        at = used[0].target_T_scan
        poses = np.array(((at.x(), at.y(), at.theta()),))
        return first.points, first.lines, first.windows, first.flags, *first.alone, poses
    _, points, lines, windows, flags, *_, alone = zip(*(r.scan for r in used), strict=True)
    geometries, tables = [each[1] for each in alone], [each[2] for each in alone]
    joined = [np.concatenate(arrays) for arrays in (points, lines, windows, flags, geometries)]
    reach2 = tables[0]  # one table serves all scans of the same beam spacing
    if any(table is not reach2 for table in tables):
        reach2 = np.concatenate(tables)
        joined.append(reach2)
    for array in joined:  # like those of a single scan, so that one compiled kernel serves both
        array.setflags(write=False)
    starts = np.array([0, *accumulate(map(len, points))])
    poses = np.array([(at.x(), at.y(), at.theta()) for at, _ in used])
    return *joined[:4], starts, joined[4], reach2, poses


def _refused(guess: Pose2, prior: Prior | None, reason: str) -> MatchResult:
    covariance = _IGNORANCE if prior is None else prior.covariance
    return MatchResult(
        guess, _NO_INFORMATION, covariance, 0, 0.0, 0.0, 0.0, 0.0, None, np.inf, 0, False, reason
    )
