"""What a loop closure knows along its weak direction, and what it only seems to know."""

from __future__ import annotations

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.degeneracy import (
    BOTH_SIDES_SHARE,
    LOOP_SIGMA_RATIO,
    NEAR_M,
    UNSEEN_SIGMA_M,
    weak_sigmas,
)
from slam.frontend.match_types import MatchResult
from slam.frontend.scan import VALID, PreparedScan

Matrix = NDArray[np.float64]


def without_degenerate_direction(
    result: MatchResult, old: PreparedScan, new: PreparedScan, predicted: Pose2
) -> MatchResult:
    """The match without information along a degenerate direction; itself if there is none.

    A wall's recesses show one face to the robot that comes and the other to the one that goes
    back.  All that both see of them is the step itself, between beams that lie far apart, so that
    lines across it slant one way in one scan and the other way in the other.  Such matches are
    consistent with themselves but err by ten sigmas along the wall.  What remains is the
    information across the wall and of the heading; along it the pose is the `predicted` one.

    Args:
        result: target_T_source, the target frame being that of `old`.
        old: scan of the old place.
        new: scan that was matched.
        predicted: target_T_source by the graph.
    """
    along, weak, strong = weak_sigmas(result.information)
    degenerate = weak > UNSEEN_SIGMA_M
    if not degenerate and weak > LOOP_SIGMA_RATIO * strong:
        axis = result.target_T_source.rotation().matrix() @ along
        shared = seen_from_both_sides(result.target_T_source, old, new, axis)
        degenerate = shared > BOTH_SIDES_SHARE
    if not degenerate:
        return result
    shift = np.array([along[0], along[1], 0.0])
    information = result.information - np.outer(shift, shift) / weak**2
    # The heading changes along with it so that the walls across still fit.
    shift[2] = -float(shift @ result.information[2]) / max(result.information[2, 2], 1e-300)
    error = Pose2.Logmap(result.target_T_source.between(predicted))
    pose = result.target_T_source * Pose2.Expmap(float(error[:2] @ along) * shift)
    angle = float(np.arctan2(along[1], along[0]))
    return result._replace(
        target_T_source=pose, information=information, degenerate_direction=angle
    )


def seen_from_both_sides(
    old_T_new: Pose2, old: PreparedScan, new: PreparedScan, axis: Matrix
) -> float:
    """Share of the new scan's nearer points that lie between both lasers along an axis.

    Args:
        old_T_new: where the new scan was taken.
        old: scan of the old place.
        new: the new scan.
        axis: unit vector (2,) in the frame of `old`.
    """
    points = new.points[(new.flags & VALID) > 0]
    offsets = points - new.geometry[2:4]
    points = points[np.hypot(offsets[:, 0], offsets[:, 1]) < NEAR_M]
    if not len(points):
        return 0.0
    placed = old_T_new.transformFrom(np.asfortranarray(points.T)).T
    here = old_T_new.transformFrom(new.geometry[2:4])
    from_old, from_new = (placed - old.geometry[2:4]) @ axis, (placed - here) @ axis
    return float(np.mean(from_old * from_new < 0.0))
