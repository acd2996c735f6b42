"""The pipeline on drives whose truth is known, and on places that have little to offer."""

from collections import Counter
from dataclasses import replace
from itertools import islice

import numpy as np
from gtsam import Pose2
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import scenario
from slam.logs.messages import LaserScan, TruePose, WheelOdometry

from slam.mapping.slam import MATCHES_A_STEP, Slam
from slam.runs.config_file import load_config

DEFAULTS = load_config(None)
NO_LOOPS = load_config(None, ["loops.enabled=false"])
ROOM = World.from_polygon([(-4, -3), (5, -3), (5, 2), (2, 2), (2, 4), (-4, 4)])


def run(messages, config=NO_LOOPS):
    slam = Slam(config)
    for message in messages:
        slam.step(message)
    slam.finish_input()
    return slam


def errors(slam):
    """Distance (m) of each keyframe from its truth, where the odometry here is the truth."""
    truth = np.array([[k.odom_T_base.x(), k.odom_T_base.y()] for k in slam.keyframes])
    return np.hypot(*(slam.graph.poses[:, :2] - truth).T)


def test_an_exact_drive_is_followed_closely(sense):
    poses = [
        Pose2(0.8 * np.sin(0.05 * k), 0.6 - 0.6 * np.cos(0.05 * k), 0.05 * k) for k in range(120)
    ]
    slam = run(sense(ROOM, poses))
    assert errors(slam).max() < 0.02
    assert slam.lost == slam.noted == Counter()


def test_the_graph_starts_at_the_origin_wherever_the_odometry_does(sense, straight):
    messages = sense(ROOM, straight(1.5, start=-1.0))
    moved = [
        replace(m, x=m.x + 100.0, y=m.y - 40.0) if isinstance(m, WheelOdometry) else m
        for m in messages
    ]
    here, there = run(messages), run(moved)
    np.testing.assert_allclose(there.graph.poses, here.graph.poses, atol=1e-6)
    np.testing.assert_array_equal(here.graph.poses[0], 0.0)


def test_truth_is_never_read(sense, straight):
    messages = sense(ROOM, straight(2.0, start=-1.0))
    without = [m for m in messages if not isinstance(m, TruePose)]
    assert run(messages).graph.poses.tobytes() == run(without).graph.poses.tobytes()


def test_equal_messages_give_equal_bits():
    messages = list(simulate(scenario("office", 2), seed=2))[:900]
    one, other = run(messages, DEFAULTS), run(messages, DEFAULTS)
    assert one.graph.poses.tobytes() == other.graph.poses.tobytes()
    assert one.records.factors == other.records.factors
    assert [v.reason for v in one.loops.closure_results] == [
        v.reason for v in other.loops.closure_results
    ]


def test_every_factor_and_decision_is_recorded(sense, straight):
    slam = run(sense(ROOM, straight(3.0, start=-1.5)))
    n = len(slam.keyframes)
    assert [d.index for d in slam.records.decisions] == list(range(n))
    assert slam.records.decisions[0].reason == "first"
    kinds = Counter(f.kind for f in slam.records.factors if f.used)
    assert kinds == {"odometry": n - 1, "icp": n - 1}
    assert len(slam.graph.edges) == sum(f.used for f in slam.records.factors)
    # A decision shows what the keyframe before it made of the walls.
    assert all(d.t_pe >= 0 and len(d.sums) == 4 for d in slam.records.decisions[1:])


def test_a_robot_that_sees_nothing_for_a_while_goes_on_when_it_sees_again(sense, straight):
    messages = sense(ROOM, straight(4.0, start=-2.0))
    scans = [m for m in messages if isinstance(m, LaserScan)]
    dark = {scan.stamp_ns for scan in scans[20:50]}
    blind = [
        replace(m, ranges=np.full_like(m.ranges, np.inf))
        if isinstance(m, LaserScan) and m.stamp_ns in dark else m
        for m in messages
    ]  # fmt: skip
    slam = run(blind)
    assert slam.noted["scan without any return"] == 30
    assert slam.noted["keyframe postponed: scan too empty"] > 0
    assert not dark & {k.scan.stamp_ns for k in slam.keyframes}
    assert slam.keyframes[-1].scan.stamp_ns > max(dark)
    assert errors(slam).max() < 0.05


def test_a_robot_that_never_sees_anything_has_no_graph(sense, straight):
    slam = run(sense(World(), straight(2.0)))
    assert slam.graph is None
    assert slam.keyframes == []


def test_scans_that_come_before_their_odometry_wait_for_it(sense, straight):
    messages = sense(ROOM, straight(1.0))
    scans = [m for m in messages if isinstance(m, LaserScan)]
    late = []
    for m in messages:
        if isinstance(m, LaserScan):
            late.insert(len(late) - 2, m)  # before the odometry and truth of its stamp
        else:
            late.append(m)
    slam = run(late)
    assert len(slam.scans) == len(scans)
    assert slam.graph.poses.tobytes() == run(messages).graph.poses.tobytes()


def test_messages_that_run_backwards_are_counted_and_left_out(sense, straight):
    messages = sense(ROOM, straight(1.5, start=-1.0))
    again = messages[:40] + messages[10:40] + messages[40:]
    slam, plain = run(again), run(messages)
    repeated = Counter(type(m) for m in messages[10:40])
    # Odometry of the last stamp is taken as news of it, any older one is not.
    assert slam.lost["scan with a stamp that runs backwards"] == repeated[LaserScan]
    assert slam.lost["odometry with a stamp that runs backwards"] == repeated[WheelOdometry] - 1
    assert slam.graph.poses.tobytes() == plain.graph.poses.tobytes()


def test_a_bad_stretch_is_worked_off_in_later_steps_with_the_same_result(monkeypatch):
    """Matches that nobody trusts halve an interval into many; no step may take them all."""
    stall = OdometryFault("stall", 6.0, 2.0, None)
    messages = list(islice(simulate(scenario("office"), seed=1, faults=[stall]), 700))
    config = load_config(None, ["loops.enabled=false", "registration.min_inlier_fraction=1"])
    slam, most = Slam(config), 0
    for message in messages:
        before = slam.matches
        slam.step(message)
        most = max(most, slam.matches - before)
    slam.finish_input()
    assert most == MATCHES_A_STEP
    monkeypatch.setattr("slam.mapping.slam.MATCHES_A_STEP", 1000)
    run_inline, most = Slam(config), 0
    for message in messages:
        before = run_inline.matches
        run_inline.step(message)
        most = max(most, run_inline.matches - before)
    run_inline.finish_input()
    assert most > 10
    assert slam.graph.poses.tobytes() == run_inline.graph.poses.tobytes()
    assert slam.records.factors == run_inline.records.factors
