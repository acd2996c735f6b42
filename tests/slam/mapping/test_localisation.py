"""Poses in a finished map: tracked, found from nothing, and honest when they are not known."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.se2 import compose
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.worlds import scenario
from slam.frontend.agreement import Agreement
from slam.logs.messages import LaserScan, TruePose, WheelOdometry

from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.mapping.localisation.evidence import near_enough, scan_evidence, tracked_right
from slam.mapping.localisation.localiser import Localiser
from slam.mapping.relocalise import PriorMap
from slam.runs.offline import run_offline

CONFIG = SlamConfig()
LASER = replace(LASERS["hokuyo-181"], rate_hz=4.0)


def drive(name="office", seed=3, noise=103):
    return list(simulate(scenario(name, seed), LASER, seed=noise))


@pytest.fixture(scope="module")
def office():
    """The map of an office in the world's frame."""
    result = run_offline(lambda: simulate(scenario("office", 3), LASER, seed=3), CONFIG)
    true = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    at = np.array([true[stamp] for stamp in result.keyframes.stamps_ns.tolist()])
    poses = compose(align(result.keyframes.poses, at), result.keyframes.poses)
    extrinsics = result.slam.extrinsics
    return PriorMap(result.slam.keyframes, poses, [], [], [], extrinsics, [], None)


def located(prior, messages):
    localiser = Localiser(CONFIG, prior)
    found = [scan for message in messages for scan in localiser.step(message)]
    return [*found, *localiser.finish()]


def errors(found, messages):
    truth = {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in messages if isinstance(m, TruePose)}
    off = [truth[s.stamp_ns].between(s.map_T_base) for s in found]
    return np.array([(np.hypot(e.x(), e.y()), abs(e.theta())) for e in off])


def first_part(messages, seconds):
    return [m for m in messages if m.stamp_ns <= messages[0].stamp_ns + seconds * 1e9]


def test_a_given_start_is_tracked_to_the_centimetre(office):
    messages = first_part(drive(), 30.0)
    start = next(m for m in messages if isinstance(m, TruePose))
    about = Pose2(start.x + 0.4, start.y - 0.3, start.theta + 0.2)
    found = located(replace(office, start=about), messages)
    off = errors(found, messages)
    assert not any(s.lost for s in found)
    assert np.median(off[:, 0]) < 0.02
    assert off[:, 0].max() < 0.1


def test_a_robot_finds_itself_from_nothing_and_claims_nothing_wrong(office):
    messages = first_part(drive(), 30.0)
    found = located(office, messages)
    sure = [s for s in found if not s.lost]
    assert found[0].lost  # one scan fits in more than one place
    assert len(sure) > 0.5 * len(found)
    assert errors(sure, messages)[:, 0].max() < 0.1


def test_equal_messages_give_equal_poses(office):
    messages = first_part(drive(), 12.0)

    def rows():
        return [
            (s.stamp_ns, s.map_T_base.x(), s.map_T_base.theta(), s.wrong, s.hypotheses)
            for s in located(office, messages) if s.map_T_base is not None
        ]  # fmt: skip

    assert rows() == rows()


def test_without_odometry_the_laser_alone_serves(office):
    messages = [m for m in first_part(drive(), 30.0) if not isinstance(m, WheelOdometry)]
    start = next(m for m in messages if isinstance(m, TruePose))
    prior = replace(office, start=Pose2(start.x, start.y, start.theta))
    found = located(prior, messages)
    sure = [s for s in found if not s.lost]
    assert len(sure) > 0.9 * len(found)
    assert errors(sure, messages)[:, 0].max() < 0.2


def test_a_wrong_start_is_not_believed(office):
    messages = first_part(drive(), 20.0)
    start = next(m for m in messages if isinstance(m, TruePose))
    prior = replace(office, start=Pose2(start.x + 6.0, start.y + 1.0, start.theta + 1.5))
    sure = [s for s in located(prior, messages) if not s.lost]
    assert not sure or errors(sure, messages)[:, 0].max() < 0.5


def test_a_kidnapped_robot_notices_and_finds_itself(office):
    messages = drive()
    scans = [m.stamp_ns for m in messages if isinstance(m, LaserScan)]
    away, back = scans[len(scans) // 4], scans[len(scans) // 2]
    start = next(m for m in messages if isinstance(m, TruePose))
    prior = replace(office, start=Pose2(start.x, start.y, start.theta))
    wheels = [m for m in messages if isinstance(m, WheelOdometry)]
    last = [m for m in wheels if m.stamp_ns <= away][-1]
    first = next(m for m in wheels if m.stamp_ns >= back)
    jump = Pose2(last.x, last.y, last.theta) * Pose2(first.x, first.y, first.theta).inverse()

    def told(m):
        if not isinstance(m, WheelOdometry):
            return m
        pose = jump * Pose2(m.x, m.y, m.theta)
        return replace(m, x=pose.x(), y=pose.y(), theta=pose.theta())

    before = [m for m in messages if m.stamp_ns <= away]
    after = [told(m) for m in messages if m.stamp_ns >= back]
    found = [s for s in located(prior, [*before, *after]) if s.stamp_ns >= back]
    off = errors(found, messages)
    lost = np.array([s.lost for s in found])
    wrong = ~lost & (off[:, 0] > 0.5)
    seconds = np.array([(s.stamp_ns - back) * 1e-9 for s in found])
    assert not wrong[seconds > 5.0].any()
    assert (~lost & (off[:, 0] < 0.1)).any()


def test_another_building_is_not_taken_for_the_map(office):
    found = located(office, first_part(drive("clutter", 1, 101), 60.0))
    assert all(s.lost for s in found)


def test_what_contradicts_speaks_against_a_pose():
    fits, torn = Agreement(20.0, 0.0, 0.0), Agreement(10.0, 0.0, 10.0)
    assert scan_evidence(fits) > 2.0 > -2.0 > scan_evidence(torn)
    assert tracked_right(scan_evidence(fits)) > 0.99
    assert tracked_right(-8.0) < 0.1


def test_a_pose_that_may_be_far_off_is_not_sure():
    assert near_enough(np.diag([0.02, 0.02, 0.01]) ** 2) > 0.999
    assert near_enough(np.diag([2.0, 0.02, 0.01]) ** 2) < 0.3
    assert near_enough(np.diag([0.02, 0.02, 1.0]) ** 2) < 0.3
