"""The whole point-to-line match in one compiled call: passes, then what they are worth."""

from __future__ import annotations

import numpy as np
from numba import njit

from frontend.covariance_kernels import combine, invert3, own_information, weakest_axis
from frontend.evidence_kernels import discount_weak_axis, step_back
from frontend.icp_kernels import SYSTEM, gauss_newton
from frontend.scatter_kernels import scatter

TRUSTED_SHARE = 0.5  # of its information that the weak axis must show to keep its place


@njit(cache=True, nogil=True, error_model="numpy")
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
    pose,
    prior,
    prior_covariance,
    has_prior,
    passes,
    noise,
    variance,
    floor_trans,
    floor_rot,
    iterations,
    information,
    covariance,
    system,
):
    """Align from `pose` (3,), overwritten; fills information, covariance (3, 3) and system.

    `passes` (k, 4) holds gate (m), robust scale (m), tolerance (m) and beams (0 for all) of each
    pass.  Without a prior, `prior_covariance` only completes the covariance of blind axes.
    Returns (size of the last step in m, iterations, weak axis in rad, weakness).
    """
    known = np.empty((3, 3))
    invert3(prior_covariance, known)
    pull = known.copy() if has_prior else np.zeros((3, 3))
    centre = prior.copy()
    partners = np.empty((len(starts) - 1, len(source_points)), dtype=np.int32)
    gradient = np.empty(6)
    size, count = 0.0, 0
    last = len(passes) - 1
    axis, begin = np.zeros(4), 0
    for attempt in range(3):
        for k in range(begin, last + 1):
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
                noise * passes[k, 1] / passes[last, 1],
                passes[k, 0],
                passes[k, 1],
                iterations,
                passes[k, 2],
                partners,
                system,
            )
            count += used
        if not has_prior:  # nothing to lean on instead, and no time to lose
            break
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
        )
        # Where the scans only seem to know, the pose goes back to the prior, and is held there
        # if it slides off again.
        if share >= TRUSTED_SHARE or attempt == 2:
            break
        step_back(pose, prior, known, noise, axis)
        begin = last
        if attempt == 1:
            centre[:] = pose
            hold = system[0] + system[3]
            for k in range(2):
                for m in range(2):
                    pull[k, m] += hold / (noise * noise) * axis[k] * axis[m]
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
    own_information(
        system, gradient, variance * max(surplus, 1.0), floor_trans, floor_rot, information
    )
    combine(information, known, covariance)
    weakest, weakness = weakest_axis(information, prior_covariance)
    return size, count, weakest, weakness


__all__ = ["SYSTEM", "align"]
