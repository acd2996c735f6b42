"""Recordings as people report them, replayed: what becomes of the path."""

import math
from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LaserConfig
from slam.drivers.simulators.worlds import scenario
from slam.logs.doctor import diagnose
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry
from slam.logs.trajectory import read_tum

from slam.runs.config_file import load_config
from slam.runs.replay import replay

S = 10**9
HUGE_M = 1e256


@pytest.fixture
def played(tmp_path):
    """Writes and replays messages; the mean error (m), the summary and the log."""
    count = iter(range(99))

    def play(messages, receipt_ns=lambda message: message.stamp_ns, config=()):
        number = next(count)
        log = tmp_path / f"{number}.mcap"
        with LogWriter(log) as writer:
            for message in messages:
                writer.write(message, receipt_ns(message))
        out = tmp_path / f"run{number}"
        summary = replay(log, out, load_config(None, list(config)))
        return error_m(messages, read_tum(out / "trajectory.tum")), summary, log, out

    return play


def error_m(messages, track):
    """Mean distance from the truth after the first poses are laid over each other."""
    truth = [m for m in messages if isinstance(m, TruePose)]
    times = [m.stamp_ns for m in truth]
    start = Pose2(truth[0].x, truth[0].y, truth[0].theta)
    first = Pose2(*track.poses[0])
    apart = []
    for stamp, pose in zip(track.stamps_ns, track.poses, strict=True):
        there = truth[int(np.searchsorted(times, stamp).clip(0, len(truth) - 1))]
        wanted = start.between(Pose2(there.x, there.y, there.theta))
        got = first.between(Pose2(*pose))
        apart.append(math.hypot(got.x() - wanted.x(), got.y() - wanted.y()))
    return float(np.mean(apart))


def drive(world="testbed-180cm", seed=1, seconds=40.0, **how):
    messages = simulate(scenario(world, seed), seed=seed, **how)
    first = None
    for message in messages:
        first = first or message.stamp_ns
        if message.stamp_ns - first > seconds * S:
            return
        yield message


@pytest.fixture(scope="module")
def sound():
    return list(drive())


@pytest.mark.parametrize("ahead_s", [3600.0, -402.0])
def test_r15_clocks_far_apart_are_not_mapped(sound, played, ahead_s):
    wheels = [replace(m, stamp_ns=m.stamp_ns + int(ahead_s * S))
              if isinstance(m, WheelOdometry) else m for m in sound]  # fmt: skip
    receipts = {id(changed): m.stamp_ns for changed, m in zip(wheels, sound, strict=True)}
    named = rf"clocks of /scan and /odom differ by {abs(ahead_s):g} s.*--use-receipt-time"
    with pytest.raises(LogError, match=named):
        played(wheels, lambda message: receipts[id(message)])


def test_r15_clocks_a_little_apart_are_mapped_with_a_warning(sound, played):
    late = [replace(m, stamp_ns=m.stamp_ns + int(0.4 * S))
            if isinstance(m, WheelOdometry) else m for m in sound]  # fmt: skip
    receipts = {id(changed): m.stamp_ns for changed, m in zip(late, sound, strict=True)}
    _, _, log, _ = played(late, lambda message: receipts[id(message)])
    assert ("clocks-apart", "warning") in {(f.code, f.severity) for f in diagnose(log).findings}


@pytest.mark.parametrize("fitted", [False, True])
def test_r05_beam_counts_that_change_cost_nothing(sound, played, fitted):
    rng = np.random.default_rng(5)
    world = scenario("testbed-180cm", 1).world
    truth = [m for m in sound if isinstance(m, TruePose)]
    at = [m.stamp_ns for m in truth]

    def turned(counts):
        for message in sound:
            if not isinstance(message, LaserScan):
                yield replace(message, x=0.0) if isinstance(message, LaserExtrinsics) else message
                continue
            n = int(rng.choice(counts))
            step = math.tau / (n if fitted else 455)
            there = truth[min(int(np.searchsorted(at, message.stamp_ns)), len(at) - 1)]
            angles = -math.pi + step * np.arange(n)
            pose = Pose2(there.x, there.y, there.theta)
            ranges = world.cast(pose, angles, 12.0) + rng.normal(0.0, 0.02, n)
            yield LaserScan(message.stamp_ns, -math.pi, step, ranges.astype(np.float32),
                            range_max=12.0)  # fmt: skip

    fixed, _, _, _ = played(list(turned([455])))
    error, summary, log, _ = played(
        list(turned([453, 454, 455, 456, 457] if fitted else [455, 456]))
    )
    assert summary["lost"] == {}
    assert abs(error - fixed) < 0.01
    found = {finding.code: finding.severity for finding in diagnose(log).findings}
    assert "two-lasers" not in found
    assert "error" not in found.values()


@pytest.mark.parametrize("x", [HUGE_M, 1e300, 1e12])
@pytest.mark.parametrize("at", [0, 20])
def test_r22_odometry_where_no_robot_can_be_is_as_if_it_were_not_there(sound, played, x, at):
    wheels = [k for k, m in enumerate(sound) if isinstance(m, WheelOdometry)]
    bad = list(sound)
    bad[wheels[at]] = replace(bad[wheels[at]], x=x)
    without = [m for k, m in enumerate(sound) if k != wheels[at]]
    _, summary, log, out = played(bad)
    _, _, _, plain = played(without)
    assert (out / "trajectory.tum").read_bytes() == (plain / "trajectory.tum").read_bytes()
    assert summary["lost"] == {"odometry where no robot can be": 1}
    assert all(len(f.text) < 300 for f in diagnose(log).findings)


def test_r30_a_laser_that_looks_back_maps_as_well_as_one_that_looks_ahead(played):
    """Closures must not turn the map by half a turn."""
    laser = LaserConfig(beams=360, angle_min=-math.pi, angle_step=math.tau / 360)
    errors = []
    for yaw in (0.0, math.pi):
        back = Pose2(0.16, 0.0, yaw)
        error, _, _, _ = played(
            list(simulate(scenario("office-ring", 1), laser, seed=1, base_T_laser=back))
        )
        errors.append(error)
    assert max(errors) < 0.10
    assert abs(errors[0] - errors[1]) < 0.03


def test_r30_a_view_of_90_degrees_costs_at_most_three_times(played):
    def error(beams):
        half = math.radians((beams - 1) / 2)
        laser = LaserConfig(beams=beams, angle_min=-half, angle_step=math.radians(1.0))
        return played(list(simulate(scenario("office", 1), laser, seed=1)))[0]

    assert error(91) <= 3.0 * max(error(181), 0.01)


def test_r30_odometry_that_is_set_to_zero_half_way(sound, played):
    wheels = [m for m in sound if isinstance(m, WheelOdometry)]
    middle = wheels[len(wheels) // 2]
    start = Pose2(middle.x, middle.y, middle.theta)

    def restarted(message):
        if not isinstance(message, WheelOdometry) or message.stamp_ns < middle.stamp_ns:
            return message
        pose = start.between(Pose2(message.x, message.y, message.theta))
        return replace(message, x=pose.x(), y=pose.y(), theta=pose.theta())

    usual, _, _, _ = played(sound)
    error, summary, log, _ = played([restarted(m) for m in sound])
    assert error <= 2.0 * max(usual, 0.005)
    assert summary["lost"].get("scans", 0) == 0
    assert {f.code for f in diagnose(log).findings} & {"jump", "odometry-jump"}


def test_r30_a_heading_that_creeps_while_the_robot_stands(sound, played):
    first = next(m for m in sound if isinstance(m, LaserScan))
    scans = [m for m in sound if isinstance(m, LaserScan)][:10]
    stand = [LaserExtrinsics(first.stamp_ns, 0.16, 0.0, 0.0)]
    for k in range(600):  # a minute at 10 Hz, 0.2 deg/s
        stamp = first.stamp_ns + k * S // 10
        stand.append(WheelOdometry(stamp, 0.0, 0.0, math.radians(0.02 * k)))
        stand.append(TruePose(stamp, 0.0, 0.0, 0.0))
        stand.append(replace(scans[k % len(scans)], stamp_ns=stamp))
    error, summary, _, out = played(stand)
    track = read_tum(out / "trajectory.tum")
    headings = np.array([pose[2] for pose in track.poses])
    assert error < 0.01
    assert np.abs(headings - headings[0]).max() < math.radians(0.5)
    assert summary["keyframes"] <= 12  # the wheels say that it turns by 12 degrees


def test_r30_times_from_beam_to_beam_that_are_too_short_do_no_harm(played):
    laser = LaserConfig(beams=360, angle_min=-math.pi, angle_step=math.tau / 360,
                        beam_period_s=0.1 / 360)  # fmt: skip
    messages = [replace(m, beam_period_s=0.05 * m.beam_period_s) if isinstance(m, LaserScan) else m
                for m in drive("office", laser=laser)]  # fmt: skip
    plain, _, log, _ = played(messages, config=["scan.deskew=false"])
    deskewed, _, _, _ = played(messages, config=["scan.deskew=true"])
    assert deskewed <= plain + 0.005
    assert "scan-time" in {f.code for f in diagnose(log).findings}
