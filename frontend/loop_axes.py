"""What a loop closure knows along its weak axis, and what it only seems to know."""

from __future__ import annotations

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.match_types import MatchResult
from slam.frontend.scan import VALID, PreparedScan

Matrix = NDArray[np.float64]

BLIND_M = 0.02  # m, own sigma beyond which a match slides along an axis rather than knows it
LOPSIDED = 2.5  # ratio of the sigmas of two axes, beyond which there is a weak one
NEAR_M = 10.0  # m, points that decide from which side a place is seen


def without_blind_axis(
    result: MatchResult, old: PreparedScan, new: PreparedScan, predicted: Pose2
) -> MatchResult:
    """The match with nothing said along the axis that it does not know; itself if there is none.

    A wall's recesses show one face to the robot that comes and the other to the one that goes
    back; all that both see of them is the step itself, between beams that lie far apart, so that
    lines across it slant one way in one scan and the other way in the other.  Such matches agree
    with themselves but err by ten sigmas along the wall.  What remains is what the walls say
    across it, and of the heading; along it the pose is the one that was `predicted`.

    Args:
        result: target_T_source, the target frame being that of `old`.
        old: scan of the old place.
        new: scan that was matched.
        predicted: target_T_source as the graph has it.
    """
    along, weak, strong = degenerate_direction(result.information)
    blind = weak > BLIND_M
    if not blind and weak > LOPSIDED * strong:
        axis = result.target_T_source.rotation().matrix() @ along
        blind = seen_from_both_sides(result.target_T_source, old, new, axis) > 0.5
    if not blind:
        return result
    shift = np.array([along[0], along[1], 0.0])
    information = result.information - np.outer(shift, shift) / weak**2
    # The heading goes along so that what the walls say stays fulfilled.
    shift[2] = -float(shift @ result.information[2]) / max(result.information[2, 2], 1e-300)
    error = Pose2.Logmap(result.target_T_source.between(predicted))
    pose = result.target_T_source * Pose2.Expmap(float(error[:2] @ along) * shift)
    angle = float(np.arctan2(along[1], along[0]))
    return result._replace(
        target_T_source=pose, information=information, degenerate_direction=angle
    )


def degenerate_direction(information: Matrix) -> tuple[Matrix, float, float]:
    """Unit vector (2,) of the worst known translation, its sigma and that across it, in m.

    The heading is marginalised; sigmas are inf where nothing is known.
    """
    turn = max(information[2, 2], 1e-300)
    known = information[:2, :2] - np.outer(information[:2, 2], information[2, :2]) / turn
    values, vectors = np.linalg.eigh(known)
    weak, strong = (1.0 / np.sqrt(v) if v > 0.0 else np.inf for v in values)
    return vectors[:, 0], float(weak), float(strong)


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
