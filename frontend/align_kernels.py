"""The whole point-to-line match in one compiled call: all starts and passes, and the result."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import addressed_kernel, merged, part
from slam.frontend.covariance_kernels import combine, invert3, own_information
from slam.frontend.degeneracy import STRONGEST_PAIRS, TRUSTED_SHARE, weakest_direction
from slam.frontend.evidence_kernels import discount_weak_direction, step_back
from slam.frontend.heading_kernels import discount_heading
from slam.frontend.icp_kernels import gauss_newton
from slam.frontend.match_arrays import (
    COST,
    FITTING,
    INLIERS,
    PAIRED,
    PAIRS,
    SYSTEM,
    TRIED,
    WEIGHT,
    Limits,
    Pass,
    PriorTerm,
    References,
    Source,
    Workspace,
)
from slam.frontend.scatter_kernels import scatter

COARSE = 2  # passes after which other starts are compared
ATTEMPTS = 3  # runs with a prior: one free, one from where the prior puts it, one held there


@addressed_kernel
def align(source, references, start, prior, passes, others, limits):
    """Align from `start`, target_T_source as (x, y, theta), and judge the outcome.

    Args:
        source: the fields of `Source`.
        references: the fields of `References`.
        start: (x, y, theta).
        prior: ((x, y, theta), covariance (3, 3), given): pose and its error, and whether there is
            one; if not, the covariance only completes that of degenerate directions.
        passes: (k, 4) gate (m), robust scale (m), tolerance (m) and beams (0 for all) of each pass.
        others: (m, 3) starts about the guess, tried when less than `good_inlier_fraction` of the
            beams fit; with a prior there are none.
        limits: the fields of `Limits`.

    Returns:
        The pose (x, y, theta), information and covariance (3, 3), size of the last step (m),
        iterations, weak direction (rad), condition ratio, and of the sums: pairs, inliers, beams
        paired, fitting and tried, cost, weight.
    """
    scan, stack, limit = Source(*source), References(*references), Limits(*limits)
    at, prior_covariance, has_prior = prior
    # Few arrays of few kinds: each kind is compiled, and each array is paid for in every match.
    count_references = len(stack.starts) - 1
    both = np.empty((2, count_references, len(scan.points)), dtype=np.int32)
    rows, squares = np.zeros((7, SYSTEM)), np.zeros((3, 3, 3))
    transforms, scratch = np.empty((count_references, 4)), np.empty((4, 6))
    system, pose, gradient = rows[0], rows[1, :3], rows[2, :6]
    work = Workspace(both[0], system, transforms, scratch, rows[4, :4], rows[5, :STRONGEST_PAIRS])
    pose[0], pose[1], pose[2] = start
    known = squares[0]
    invert3(prior_covariance, known)
    if has_prior:
        centre = rows[3, :3]
        centre[0], centre[1], centre[2] = at
        size, count = run_passes_with_prior(
            scan, stack, pose, PriorTerm(centre, known), passes, limit, work, squares
        )
    else:
        spare = Workspace(both[1], rows[6], transforms, scratch, work.direction, work.strongest)
        size, count = run_passes_from_many(
            scan, stack, pose, passes, others, limit, work, spare, squares
        )
    surplus = scatter(
        scan, stack, pose, work.pairs, passes[len(passes) - 1, 1], limit.noise, gradient
    )
    information, covariance = np.empty((3, 3)), np.empty((3, 3))
    own_information(
        system,
        gradient,
        limit.variance * max(surplus, 1.0),
        limit.floor_trans,
        limit.floor_rot,
        information,
    )
    combine(information, known, covariance)
    weakest, condition_ratio = weakest_direction(information, prior_covariance)
    return (
        pose[0],
        pose[1],
        pose[2],
        information,
        covariance,
        size,
        count,
        weakest,
        condition_ratio,
        int(system[PAIRS]),
        system[INLIERS],
        system[PAIRED],
        system[FITTING],
        system[TRIED],
        system[COST],
        system[WEIGHT],
    )


@merged
def level_of(passes, k, beams, limits):
    """Pass k of `passes`, for a source of so many beams."""
    wanted = int(passes[k, 3])
    stride = max(1, beams // wanted) if wanted > 0 else 1
    # Far pairs are wrong by as much as their pass allows: they push no harder against the prior
    # than that.
    noise = limits.noise * passes[k, 1] / passes[len(passes) - 1, 1]
    return Pass(passes[k, 0], passes[k, 1], passes[k, 2], stride, noise, limits.iterations)


@part
def run_passes(source, references, pose, prior, passes, limits, work):
    """Run all passes from `pose` (3,), overwritten; (size of the last step in m, iterations)."""
    size, count = 0.0, 0
    for k in range(len(passes)):
        work.pairs[:] = -1  # beams that this pass leaves out have none
        level = level_of(passes, k, len(source.points), limits)
        size, used = gauss_newton(source, references, pose, prior, level, work)
        count += used
    return size, count


@merged
def run_passes_with_prior(source, references, pose, prior, passes, limits, work, squares):
    """Find `pose` (3,) with a prior; `squares` (3, 3, 3) is scratch but for its first."""
    noise, direction, system = limits.noise, work.direction, work.system
    held = PriorTerm(squares[2, 0], squares[1])
    copy(prior.pose, held.pose)
    for k in range(3):
        copy(prior.information[k], held.information[k])
    begin, last, total, size = 0, len(passes) - 1, 0, 0.0
    final = level_of(passes, last, len(source.points), limits)
    for attempt in range(ATTEMPTS):
        size, count = run_passes(source, references, pose, held, passes[begin:], limits, work)
        total += count
        share = discount_weak_direction(source, references, pose, final, work)
        # Where the scans only seem to know, the pose goes back to the prior, and is held there
        # if it slides off again.
        if share >= TRUSTED_SHARE or attempt == ATTEMPTS - 1:
            break
        step_back(pose, prior, noise, direction)
        begin = last
        if attempt == ATTEMPTS - 2:
            copy(pose, held.pose)
            hold = system[0] + system[3]
            for k in range(2):
                for m in range(2):
                    held.information[k, m] += hold / (noise * noise) * direction[k] * direction[m]
    discount_heading(source, references, pose, final.scale, work)
    return size, total


@merged
def run_passes_from_many(source, references, pose, passes, others, limits, work, spare, squares):
    """Find `pose` (3,) with no prior, from other starts as well if the outcome is poor.

    Nothing supports the guess then, and the iteration may end in a local minimum.  The second of
    `squares` (3, 3, 3) is zero, for there is no prior; the third and `spare` are scratch.
    """
    guess, trial, best = squares[2, 0], squares[2, 1], squares[2, 2]
    copy(pose, guess)
    free = PriorTerm(guess, squares[1])
    size, count = run_passes(source, references, pose, free, passes, limits, work)
    alternatives = len(others)
    inlier_fraction = share_that_fits(work.system, limits.min_pairs)
    if inlier_fraction >= limits.good_inlier_fraction or alternatives == 0:
        return size, count
    best_inlier_fraction = inlier_fraction
    for k in range(alternatives + 1):  # the other starts, and the best of them refined
        refining = k == alternatives
        if not refining:
            compose(guess, others, k, trial)
        elif best_inlier_fraction > inlier_fraction:
            copy(best, trial)
        else:
            break
        few = passes[1:] if refining else passes[:COARSE]
        used_size, used = run_passes(source, references, trial, free, few, limits, spare)
        found = share_that_fits(spare.system, limits.min_pairs)
        if not refining:
            if found > best_inlier_fraction:
                copy(trial, best)
                best_inlier_fraction = found
        elif found > inlier_fraction:
            copy(trial, pose)
            copy(spare.system, work.system)
            for ref in range(len(work.pairs)):
                copy(spare.pairs[ref], work.pairs[ref])
            size, count = used_size, used
    return size, count


@part
def share_that_fits(system, min_pairs):
    """Share of the beams that fit a line of any reference; 0 with too few pairs."""
    return system[FITTING] / system[TRIED] if system[PAIRS] >= min_pairs else 0.0


@part
def compose(pose, others, k, out):
    """Fill `out` (3,) with `pose` (3,) followed by row k of `others` (m, 3)."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out[0] = pose[0] + c * others[k, 0] - s * others[k, 1]
    out[1] = pose[1] + s * others[k, 0] + c * others[k, 1]
    out[2] = pose[2] + others[k, 2]


@part
def copy(values, out):
    """Copy a row: assigning it to a slice would compile a check with its message, for seconds."""
    for k in range(len(values)):
        out[k] = values[k]
