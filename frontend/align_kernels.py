"""The whole point-to-line match in one compiled call: all starts and passes, and their worth."""

from __future__ import annotations

import numpy as np
from slam.frontend.compiled import kernel, merged, part
from slam.frontend.covariance_kernels import combine, invert3, own_information, weakest_direction
from slam.frontend.evidence_kernels import (
    DOUBTED_PAIRS,
    TRUSTED_SHARE,
    discount_weak_axis,
    step_back,
)
from slam.frontend.heading_kernels import doubt_heading
from slam.frontend.icp_kernels import (
    COST,
    FITTING,
    INLIERS,
    PAIRED,
    PAIRS,
    SYSTEM,
    TRIED,
    WEIGHT,
    gauss_newton,
)
from slam.frontend.scatter_kernels import scatter

COARSE = 2  # passes after which other starts are compared


@kernel
def align(
    source_points,
    source_lines,
    source_flags,
    source_geometry,
    points,
    lines,
    windows,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    x,
    y,
    theta,
    prior_x,
    prior_y,
    prior_theta,
    prior_covariance,
    has_prior,
    passes,
    others,
    noise,
    variance,
    floor_trans,
    floor_rot,
    iterations,
    min_pairs,
    good_inlier_fraction,
):
    """Align from target_T_source = (x, y, theta), and judge the outcome.

    `passes` (k, 4) holds gate (m), robust scale (m), tolerance (m) and beams (0 for all) of each
    pass, `others` (m, 3) the starts about the guess that are tried when less than
    `good_inlier_fraction` of the beams fit; with a prior there are none.  Without
    a prior, `prior_covariance` only completes the covariance of blind axes.

    Returns the pose (x, y, theta), information and covariance (3, 3), size of the last step (m),
    iterations, weak axis (rad), weakness, and of the sums: pairs, inliers, beams paired, fitting
    and tried, cost, weight.
    """
    # Few arrays of few kinds: each kind is compiled, and each array is paid for in every match.
    references = len(starts) - 1
    both = np.empty((2, references, len(source_points)), dtype=np.int32)
    rows, squares = np.zeros((7, SYSTEM)), np.zeros((3, 3, 3))
    partners, system, pose, gradient = both[0], rows[0], rows[1, :3], rows[2, :6]
    pose[0], pose[1], pose[2] = x, y, theta
    known = squares[0]
    invert3(prior_covariance, known)
    transforms, scratch = np.empty((references, 4)), np.empty((4, 6))
    if has_prior:
        prior = rows[3, :3]
        prior[0], prior[1], prior[2] = prior_x, prior_y, prior_theta
        size, count = run_passes_with_prior(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose,
            prior,
            known,
            passes,
            noise,
            iterations,
            partners,
            transforms,
            scratch,
            system,
            squares[1],
            squares[2],
            rows[4, :4],
            rows[5, :DOUBTED_PAIRS],
        )
    else:
        size, count = run_passes_from_many(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose,
            passes,
            others,
            noise,
            iterations,
            min_pairs,
            good_inlier_fraction,
            partners,
            transforms,
            scratch,
            system,
            both[1],
            rows[6],
            squares[1],
            squares[2],
        )
    surplus = scatter(
        source_points,
        source_geometry,
        points,
        lines,
        windows,
        flags,
        starts,
        geometries,
        noise,
        poses,
        pose,
        partners,
        passes[len(passes) - 1, 1],
        gradient,
    )
    information, covariance = np.empty((3, 3)), np.empty((3, 3))
    own_information(
        system, gradient, variance * max(surplus, 1.0), floor_trans, floor_rot, information
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


@part
def run_passes(
    source_points,
    source_lines,
    source_flags,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    pose,
    centre,
    pull,
    passes,
    noise,
    iterations,
    partners,
    transforms,
    scratch,
    system,
):
    """Run all passes from `pose` (3,), overwritten, with the prior `centre`, `pull`.

    Fills partners and system; returns (size of the last step in m, iterations).
    """
    size, count = 0.0, 0
    finest = passes[len(passes) - 1, 1]
    for k in range(len(passes)):
        beams = int(passes[k, 3])
        partners[:] = -1  # beams that this pass leaves out have none
        stride = max(1, len(source_points) // beams) if beams > 0 else 1
        size, used = gauss_newton(
            source_points,
            source_lines,
            source_flags,
            stride,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose,
            centre,
            pull,
            # Far pairs are wrong by as much as their pass allows: they push no harder
            # against the prior than that.
            noise * passes[k, 1] / finest,
            passes[k, 0],
            passes[k, 1],
            iterations,
            passes[k, 2],
            partners,
            transforms,
            scratch,
            system,
        )
        count += used
    return size, count


@merged
def run_passes_with_prior(
    source_points,
    source_lines,
    source_flags,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    pose,
    prior,
    known,
    passes,
    noise,
    iterations,
    partners,
    transforms,
    scratch,
    system,
    pull,
    spots,
    axis,
    strongest,
):
    """Settle `pose` (3,) with a prior of information `known` (3, 3) about `prior` (3,).

    `pull`, `spots` (3, 3), `axis` (4,) and `strongest` (DOUBTED_PAIRS,) are scratch.
    """
    centre = spots[0]
    copy(prior, centre)
    for k in range(3):
        copy(known[k], pull[k])
    begin, last, total, size = 0, len(passes) - 1, 0, 0.0
    for attempt in range(3):
        size, count = run_passes(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose,
            centre,
            pull,
            passes[begin:],
            noise,
            iterations,
            partners,
            transforms,
            scratch,
            system,
        )
        total += count
        share = discount_weak_axis(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            pose,
            passes[last, 0],
            passes[last, 1],
            partners,
            system,
            axis,
            strongest,
        )
        # Where the scans only seem to know, the pose goes back to the prior, and is held there
        # if it slides off again.
        if share >= TRUSTED_SHARE or attempt == 2:
            break
        step_back(pose, prior, known, noise, axis)
        begin = last
        if attempt == 1:
            copy(pose, centre)
            hold = system[0] + system[3]
            for k in range(2):
                for m in range(2):
                    pull[k, m] += hold / (noise * noise) * axis[k] * axis[m]
    doubt_heading(source_points, lines, poses, pose, partners, passes[last, 1], system, strongest)
    return size, total


@merged
def run_passes_from_many(
    source_points,
    source_lines,
    source_flags,
    points,
    lines,
    flags,
    starts,
    geometries,
    reach2,
    poses,
    pose,
    passes,
    others,
    noise,
    iterations,
    min_pairs,
    good_inlier_fraction,
    partners,
    transforms,
    scratch,
    system,
    rival_partners,
    rival_system,
    free,
    spots,
):
    """Settle `pose` (3,) with no prior, from other starts as well if the outcome is poor.

    Nothing vouches for the guess then: it may have been caught on the way.
    `free` (3, 3) is zero: no prior pulls; `spots` (3, 3), `rival_partners` and `rival_system`
    are scratch.
    """
    guess, trial, best = spots[0], spots[1], spots[2]
    copy(pose, guess)
    size, count = run_passes(
        source_points,
        source_lines,
        source_flags,
        points,
        lines,
        flags,
        starts,
        geometries,
        reach2,
        poses,
        pose,
        guess,
        free,
        passes,
        noise,
        iterations,
        partners,
        transforms,
        scratch,
        system,
    )
    alternatives = len(others)
    inlier_fraction = share_that_fits(system, min_pairs)
    if inlier_fraction >= good_inlier_fraction or alternatives == 0:
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
        used_size, used = run_passes(
            source_points,
            source_lines,
            source_flags,
            points,
            lines,
            flags,
            starts,
            geometries,
            reach2,
            poses,
            trial,
            guess,
            free,
            passes[1:] if refining else passes[:COARSE],
            noise,
            iterations,
            rival_partners,
            transforms,
            scratch,
            rival_system,
        )
        found = share_that_fits(rival_system, min_pairs)
        if not refining:
            if found > best_inlier_fraction:
                copy(trial, best)
                best_inlier_fraction = found
        elif found > inlier_fraction:
            copy(trial, pose)
            copy(rival_system, system)
            for ref in range(len(partners)):
                for i in range(partners.shape[1]):
                    partners[ref, i] = rival_partners[ref, i]
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
