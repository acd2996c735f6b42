"""A closure must not say where along a wall it is if it cannot know."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.worlds import scenario
from slam.frontend.degeneracy import weak_sigmas
from slam.frontend.loop_axes import seen_from_both_sides, without_degenerate_direction

from tests.frontend.scans import (
    ALL_ROUND,
    BUILDING,
    ENDLESS,
    FINE,
    HOKUYO,
    match_one,
    prior_at,
    see,
)

LADDER = scenario("symmetric-corridors", 1).world
THERE, BACK = Pose2(20.0, 1.0, 0.0), Pose2(26.0, 1.0, np.pi)
LOOSE = np.array([0.1, 0.1, 0.03])


def closed(old_pose, new_pose, world, off=(0.0, 0.0, 0.0), laser=HOKUYO):
    """Match before and after, and the predicted pose, which is `off` the truth."""
    old, new = see(old_pose, laser, world=world), see(new_pose, laser, 1, world)
    truth = old_pose.between(new_pose)
    predicted = truth * Pose2(*off)
    result = match_one(old, new, truth, prior_at(truth, LOOSE))
    assert result.converged
    return result, without_degenerate_direction(result, old, new, predicted), predicted


def test_a_plain_corridor_says_nothing_along_itself():
    before, after, predicted = closed(
        Pose2(), Pose2(1.0, 0.2, 0.1), ENDLESS, off=(0.25, 0.0, 0.0), laser=FINE
    )
    axis, weak, _ = weak_sigmas(after.information)
    assert weak > 1e3
    along = after.target_T_source.rotation().matrix() @ axis
    assert abs(along[0]) > 0.999
    assert after.degenerate_direction is not None
    # Along the walls the prediction counts, across them and for the heading the match.
    assert after.target_T_source.x() == pytest.approx(predicted.x(), abs=0.01)
    assert after.target_T_source.y() == pytest.approx(before.target_T_source.y(), abs=0.005)
    assert after.target_T_source.theta() == pytest.approx(before.target_T_source.theta(), abs=0.002)


def test_what_is_known_across_and_of_the_heading_stays():
    before, after, _ = closed(THERE, BACK, LADDER)
    along, _, strong = weak_sigmas(before.information)
    kept_along, _, kept_strong = weak_sigmas(after.information)
    assert abs(along @ kept_along) == pytest.approx(1.0)
    assert kept_strong == pytest.approx(strong)
    assert after.information[2, 2] == before.information[2, 2]
    assert np.linalg.eigvalsh(after.information)[0] > -1e-9 * after.information.max()


def test_recesses_seen_from_both_sides_do_not_tell_how_far():
    _, after, _ = closed(THERE, BACK, LADDER)
    assert weak_sigmas(after.information)[1] > 1.0


@pytest.mark.parametrize("laser", [HOKUYO, ALL_ROUND])
def test_recesses_seen_from_the_same_side_do(laser):
    before, after, _ = closed(THERE, Pose2(20.6, 1.1, 0.05), LADDER, laser=laser)
    assert after is before


def test_a_room_that_is_seen_all_round_is_known_from_either_end():
    before, after, _ = closed(
        Pose2(-2.0, 0.0, 0.0), Pose2(2.0, 0.0, np.pi), BUILDING, laser=ALL_ROUND
    )
    assert after is before


def test_which_points_lie_between():
    old, new = see(Pose2(), world=ENDLESS), see(Pose2(6.0, 0.0, np.pi), world=ENDLESS)
    x = np.array([1.0, 0.0])
    assert seen_from_both_sides(Pose2(6.0, 0.0, np.pi), old, new, x) > 0.7
    assert seen_from_both_sides(Pose2(0.5, 0.0, 0.0), old, old, x) < 0.2


def test_no_information_at_all_is_no_error():
    result, _, predicted = closed(Pose2(), Pose2(1.0, 0.2, 0.1), ENDLESS)
    nothing = result._replace(information=np.zeros((3, 3)))
    scan = see(Pose2(), world=ENDLESS)
    assert np.isfinite(
        without_degenerate_direction(nothing, scan, scan, predicted).information
    ).all()
