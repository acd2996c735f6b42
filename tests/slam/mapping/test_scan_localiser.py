"""A scan among the keyframes: which of them it is matched against, and from where it starts."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LASERS, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.batch_matching import can_be_batched
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

from slam.mapping.keyframe import Keyframe, preparer
from slam.mapping.scan_localiser import LocaliseConfig, ScanLocaliser

MOUNT = LaserExtrinsics(0, 0.0, 0.0, 0.0)
SCAN = ScanConfig()
ROOM = World.from_polygon([(-4.0, -3.0), (5.0, -3.0), (5.0, 1.0), (2.0, 2.5), (-4.0, 3.5)])


def seen(world, pose, index):
    raw = take_scan(world, pose, LASERS["hokuyo-181"], np.random.default_rng(index))
    return raw, prepare(raw, MOUNT, SCAN)


def localiser(world, true_poses, believed=None):
    """Among keyframes taken at `true_poses`, which stand in the graph where they are believed."""
    keyframes = []
    for k, pose in enumerate(true_poses):
        raw, prepared = seen(world, pose, k)
        keyframes.append(Keyframe(k, k, raw, MOUNT, preparer(SCAN), prepared.centre, pose, 0.0, k))
    poses = np.array([(p.x(), p.y(), p.theta()) for p in believed or true_poses])
    return ScanLocaliser(keyframes, poses, LocaliseConfig(), MatchConfig())


def test_keyframes_that_look_at_the_same_from_the_other_side_do_not_pull_a_scan_along():
    """A corridor with recessed doors, driven through there and back; the way back is 8 cm off."""
    walls = []
    for side in (-1.0, 1.0):
        for x in np.arange(-12.0, 12.0, 3.0):
            near, deep = side, side * 1.15
            walls += [
                [x, near, x + 2.0, near], [x + 2.0, near, x + 2.0, deep],
                [x + 2.0, deep, x + 3.0, deep], [x + 3.0, deep, x + 3.0, near],
            ]  # fmt: skip
    corridor = World(np.array(walls))
    there = [Pose2(x, 0.0, 0.0) for x in np.arange(-5.0, 5.0, 1.0)]
    back = [Pose2(x, 0.1, np.pi) for x in np.arange(-2.0, 9.0, 0.25)]
    believed = there + [Pose2(p.x() + 0.08, p.y(), p.theta()) for p in back]
    among = localiser(corridor, there + back, believed)
    errors = []
    for k, x in enumerate(np.arange(-2.5, 1.5, 0.5)):
        true = Pose2(x, 0.02, 0.01)
        _, scan = seen(corridor, true, 100 + k)
        errors.append(among.locate(scan, Pose2(x + 0.02, 0.02, 0.0)).x() - x)
    assert np.abs(errors).max() < 0.02


@pytest.mark.parametrize("turn", [0.25, -0.25])
def test_odometry_that_comes_a_scan_late_in_a_turn_leaves_no_mark(turn):
    among = localiser(ROOM, [Pose2(0.0, 0.0, heading) for heading in np.arange(-3.0, 3.2, 0.6)])
    for k in range(8):
        true = Pose2(0.05 * k, 0.0, k * turn)
        raw, _ = seen(ROOM, true, 100 + k)
        late = k in (3, 6)
        guess = Pose2(0.05 * k, 0.0, (k - 1) * turn) if late else true
        stamped = prepare(
            type(raw)(200_000_000 * k, raw.angle_min, raw.angle_step, raw.ranges), MOUNT,
            SCAN,
        )  # fmt: skip
        error = Pose2.Logmap(true.between(among.locate(stamped, guess)))
        assert np.hypot(error[0], error[1]) < 0.02, k
        assert abs(error[2]) < 0.01, k


def test_a_start_from_a_scan_that_slid_leads_no_further_than_a_guess_may_be_off():
    """Along a bare corridor a match is as good anywhere: one wrong scan must not lead the next."""
    bare = World(np.array([[-90.0, 1.0, 90.0, 1.0], [-90.0, -1.0, 90.0, -1.0]]))

    def found(**reach):
        among = localiser(bare, [Pose2(x, 0.0, 0.0) for x in np.arange(-1.0, 4.0, 0.5)])
        slid = Pose2(-2.0, 0.0, 0.0), 0.9
        among.locate(seen(bare, Pose2(), 100)[1], Pose2(), first=slid)
        scan = seen(bare, Pose2(2.0, 0.0, 0.0), 101)[1]
        refused = Pose2(2.0, 0.0, 0.0), 0.0
        return among.locate(scan, Pose2(2.0, 0.0, 0.0), first=refused, **reach).x()

    assert found() < 0.5  # as far behind as the scan before
    assert found(reach_m=0.25) == pytest.approx(2.0, abs=0.55)


@pytest.mark.parametrize("method", ["point_to_line", "psm"])
def test_a_batch_finds_what_single_matches_find_to_the_bit(method):
    among = localiser(ROOM, [Pose2(0.4 * k, 0.1 * k, 0.7 * k - 3.0) for k in range(9)])
    among._matcher = MatchConfig(method=method)
    rng, scans, guesses = np.random.default_rng(5), [], []
    for k in range(12):
        true = Pose2(0.3 * k, 0.05 * k, 0.5 * k - 3.0)
        scans.append(seen(ROOM, true, 100 + k)[1])
        off = rng.normal(0.0, 0.02, 3) * (20.0 if k % 5 == 0 else 1.0)  # some are refused
        guesses.append(np.array([true.x(), true.y(), true.theta()]) + off)
    keyframes = [k.prepared for k in among._keyframes]
    assert can_be_batched(keyframes, among._matcher) == (method == "point_to_line")
    found = among.match_batch(scans, np.array(guesses))
    alone = [among.match_from(s, Pose2(*g)) for s, g in zip(scans, guesses, strict=True)]
    assert {quality > 0.0 for _, quality in found} == {True, False}
    for (pose, quality), (single, expected) in zip(found, alone, strict=True):
        assert quality == expected
        assert (pose.x(), pose.y(), pose.theta()) == (single.x(), single.y(), single.theta())


def test_a_scan_that_sees_nothing_and_a_guess_that_is_nowhere_keep_the_guess():
    among = localiser(ROOM, [Pose2(0.0, 0.0, 0.0)])
    raw, scan = seen(ROOM, Pose2(0.0, 0.0, 0.0), 1)
    blind = prepare(
        type(raw)(0, raw.angle_min, raw.angle_step, np.full_like(raw.ranges, np.inf)), MOUNT, SCAN
    )
    guesses = np.zeros((2, 3))
    (_, seeing), (_, unseen) = among.match_batch([scan, blind], guesses)
    assert seeing > 0.5
    assert unseen == 0.0
