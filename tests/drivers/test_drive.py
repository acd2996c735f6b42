from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.drive import (
    BASE_T_LASER,
    EPOCH_NS,
    dead_reckoning,
    paper_drive,
    simulate,
)
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.robot import ODOMETRY_NOISE, drive
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import Scenario, scenario
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

# Ahead for 3 m, back for 2 m: long enough for every fault, short enough for many drives.
SHUTTLE = Scenario(
    "shuttle",
    World.from_polygon([(-2, -2), (6, -2), (6, 2), (-2, 3)]),
    (Leg(((0.0, 0.0), (3.0, 0.0))), Leg(((3.0, 0.0), (1.0, 0.0)), reverse=True)),
)
EXACT = ODOMETRY_NOISE["none"]


def of(kind, messages):
    return [m for m in messages if isinstance(m, kind)]


def bits(messages):
    return [
        (
            type(m),
            m.stamp_ns,
            m.ranges.tobytes() if isinstance(m, LaserScan) else (m.x, m.y, m.theta),
        )
        for m in messages
    ]


def poses(messages):
    return np.array([(m.x, m.y, m.theta) for m in messages])


def test_messages_are_in_order_and_every_scan_has_its_truth_and_odometry():
    messages = list(simulate(SHUTTLE, LASERS["utm-30lx"]))
    assert isinstance(messages[0], LaserExtrinsics)
    assert messages[0].x == BASE_T_LASER.x()
    assert messages[0].stamp_ns == messages[1].stamp_ns == EPOCH_NS
    assert all(a.stamp_ns <= b.stamp_ns for a, b in pairwise(messages))
    for i, scan in enumerate(messages):
        if isinstance(scan, LaserScan):
            wheels, true = messages[i - 2 : i]
            assert isinstance(wheels, WheelOdometry)
            assert isinstance(true, TruePose)
            assert wheels.stamp_ns == true.stamp_ns == scan.stamp_ns
    stamps = [m.stamp_ns for m in of(WheelOdometry, messages)]
    assert len(stamps) == len(set(stamps))


def test_odometry_can_keep_to_its_own_clock():
    messages = list(simulate(SHUTTLE, LASERS["utm-30lx"], odometry_at_scans=False))
    gaps = np.diff([m.stamp_ns for m in of(WheelOdometry, messages)])
    np.testing.assert_array_equal(gaps, 100_000_000)


def test_equal_seeds_give_equal_bits():
    runs = [bits(simulate(SHUTTLE, seed=seed)) for seed in (7, 7, 8)]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_chance_of_wheels_and_laser_are_apart():
    plain = list(simulate(SHUTTLE, seed=3))
    other_wheels = list(simulate(SHUTTLE, noise=ODOMETRY_NOISE["pessimistic"], seed=3))
    other_laser = list(simulate(SHUTTLE, replace(LASERS["hokuyo-181"], sigma=0.05), seed=3))
    assert bits(of(LaserScan, plain)) == bits(of(LaserScan, other_wheels))
    assert bits(of(WheelOdometry, plain)) == bits(of(WheelOdometry, other_laser))
    assert bits(of(WheelOdometry, plain)) != bits(of(WheelOdometry, other_wheels))


def test_perfect_wheels_agree_with_the_truth():
    messages = list(simulate(scenario("office"), LASERS["hokuyo-181"], EXACT))
    true, wheels = of(TruePose, messages), of(WheelOdometry, messages)
    world_T_odom = Pose2(true[0].x, true[0].y, true[0].theta)
    for a, b in zip(true[::50], wheels[::50], strict=True):
        assert (world_T_odom * Pose2(b.x, b.y, b.theta)).equals(Pose2(a.x, a.y, a.theta), 1e-9)


def test_scans_are_taken_from_the_laser_not_from_the_base():
    quiet = replace(LASERS["hokuyo-181"], sigma=0.0, quantum=0.0)
    extrinsics = Pose2(0.2, 0.1, 0.3)
    messages = list(simulate(SHUTTLE, quiet, base_T_laser=extrinsics))
    true, scan = of(TruePose, messages)[70], of(LaserScan, messages)[70]
    laser = Pose2(true.x, true.y, true.theta) * extrinsics
    np.testing.assert_allclose(
        scan.ranges, SHUTTLE.world.cast(laser, quiet.bearings, 30.0), rtol=1e-6
    )


def test_a_slow_sweep_is_bent_by_motion_and_by_nothing_else():
    still = replace(LASERS["hokuyo-181"], sigma=0.0, quantum=0.0)
    slow = replace(still, beam_period_s=0.0005)
    extrinsics = Pose2(0.2, 0.1, 0.3)
    straight, bent = (
        of(LaserScan, simulate(SHUTTLE, laser, base_T_laser=extrinsics)) for laser in (still, slow)
    )
    np.testing.assert_allclose(straight[0].ranges, bent[0].ranges, rtol=1e-6)  # at rest
    apart = np.abs(straight[35].ranges - bent[35].ranges)  # at about 0.6 m/s
    assert apart[0] < 1e-6
    assert 0.01 < apart.max() < 0.2
    assert bent[0].beam_period_s == 0.0005


@pytest.mark.parametrize(("reading", "length"), [("180cm", 1.80), ("878cm", 8.78)])
def test_the_papers_drive_has_462_even_scans_on_a_line(reading, length):
    messages = list(paper_drive(reading, seed=1, geometry_seed=2))
    scans, true = of(LaserScan, messages), poses(of(TruePose, messages))
    assert len(scans) == len(true) == len(of(WheelOdometry, messages)) == 462
    assert {s.ranges.size for s in scans} == {181}
    assert {s.range_max for s in scans} == {30.0}
    np.testing.assert_allclose(true[:, 0], np.linspace(0.0, length, 462), atol=1e-9)
    assert not true[:, 1:].any()


def test_the_papers_noise_and_geometry_have_seeds_of_their_own():
    first = [
        of(LaserScan, paper_drive("180cm", s, g))[0].ranges for s, g in [(0, 0), (1, 0), (0, 1)]
    ]
    assert np.abs(first[1] - first[0]).max() < 0.1  # noise: a few centimetres at most
    assert np.abs(first[2] - first[0]).max() > 0.2  # other boards


def odometry_with(*faults):
    truth = drive(SHUTTLE.path)
    return truth, dead_reckoning(truth, EXACT, 0, faults)


def test_sign_flip_turns_only_reversing_round():
    truth, odometry = odometry_with(OdometryFault("sign-flip", at_s=0.0))
    assert truth.poses[-1, 0] == pytest.approx(1.0, abs=0.02)
    assert odometry.poses[-1, 0] == pytest.approx(5.0, abs=0.04)


def test_a_stall_freezes_odometry_for_two_seconds():
    truth, odometry = odometry_with(OdometryFault("stall", at_s=3.0))
    times = np.array([3.0, 4.0, 5.0, 6.0])
    got, true = odometry.at(times)[:, 0], truth.at(times)[:, 0]
    np.testing.assert_allclose(got[:3], true[0], atol=1e-9)
    assert true[2] - true[0] > 0.5
    assert got[3] - got[2] == pytest.approx(true[3] - true[2])


def test_a_jump_leaps_a_metre_and_a_slip_turns_by_twenty_degrees():
    jump = OdometryFault("jump", at_s=3.0, bearing=np.pi / 2)
    truth, odometry = odometry_with(jump)
    times = np.array([2.99, 3.2])
    np.testing.assert_allclose(
        odometry.at(times) - truth.at(times), [[0, 0, 0], [0, 1, 0]], atol=1e-9
    )
    truth, odometry = odometry_with(OdometryFault("slip", at_s=3.0))
    assert odometry.at(times)[0, 2] == pytest.approx(0.0, abs=1e-9)
    assert odometry.poses[-1, 2] - truth.poses[-1, 2] == pytest.approx(np.radians(20.0))


def test_a_fault_can_be_given_another_size_and_end_within_a_step():
    half = OdometryFault("slip", at_s=3.005, duration_s=0.013, size=0.5)
    truth, odometry = odometry_with(half, OdometryFault("jump", at_s=1.0, size=2.0))
    assert odometry.poses[-1, 2] - truth.poses[-1, 2] == pytest.approx(0.5)


def test_a_scan_gap_loses_scans_and_nothing_else():
    gap = [OdometryFault("scan-gap", at_s=2.0)]
    whole, holed = list(simulate(SHUTTLE)), list(simulate(SHUTTLE, faults=gap))
    stamps = [(m.stamp_ns - EPOCH_NS) * 1e-9 for m in of(LaserScan, holed)]
    assert max(np.diff(stamps)) == pytest.approx(3.1)
    assert len(of(LaserScan, whole)) - len(of(LaserScan, holed)) == 30
    assert bits(of(WheelOdometry, whole)) == bits(of(WheelOdometry, holed))


def test_impossible_faults_are_refused():
    with pytest.raises(ValueError, match="unknown fault 'flip'"):
        OdometryFault("flip", at_s=0.0)
    with pytest.raises(ValueError, match="duration"):
        OdometryFault("stall", at_s=1.0, duration_s=0.0)
