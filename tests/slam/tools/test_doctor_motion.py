"""Wheels against scans: sound drives are left in peace, injected faults are named."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.drive import EPOCH_NS, simulate
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import SCENARIOS, scenario
from slam.logs.importers.detect import read_any
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

from slam.evaluation.calibration.closed_form import fit_motion
from slam.tools.doctor import motion_check
from slam.tools.doctor.motion_check import MotionCheck
from slam.tools.doctor.motion_pairs import BLOCK, Blocks, PairCollector

REAL = Path(__file__).parents[3].parent / "shared" / "data" / "real"
MOUNT = LaserExtrinsics(EPOCH_NS, 0.16, 0.0, 0.0)


def findings(messages):
    check = MotionCheck()
    for message in messages:
        check.feed(message)
    return {f.code: f for f in check.findings()}


def office(**how):
    return simulate(scenario("office", 1), seed=1, **how)


@pytest.fixture(scope="module")
def sound():
    return list(office())


def with_wheels(messages, change):
    return [change(m) if isinstance(m, WheelOdometry) else m for m in messages]


def test_a_sound_drive_has_no_findings(sound):
    assert findings(sound) == {}


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("world", SCENARIOS)
@pytest.mark.parametrize("noise", ["none", "typical", "pessimistic"])
def test_no_sound_drive_has_more_than_a_note(world, noise):
    for seed in range(3):
        for laser in ("hokuyo-181", "utm-30lx") if seed == 0 else ("hokuyo-181",):
            drive = simulate(scenario(world, seed), LASERS[laser], ODOMETRY_NOISE[noise], seed)
            severities = {f.severity for f in findings(drive).values()}
            assert severities <= {"note"}, (seed, laser)


@pytest.mark.parametrize("kind", ["stall", "slip", "jump", "stuck-encoder"])
def test_wheels_that_lie_for_a_moment_are_found_when_it_happens(kind):
    found = findings(office(faults=[OdometryFault(kind, 12.0)]))
    assert found.keys() == {"wheel-slip"}
    assert found["wheel-slip"].severity == "warning"
    assert 10.0 < (found["wheel-slip"].at_ns - EPOCH_NS) * 1e-9 < 13.0


def test_scans_whose_stamps_come_late_by_turns_are_no_slip(monkeypatch):
    rng = np.random.default_rng(3)
    drive = list(office())
    late = [replace(m, stamp_ns=m.stamp_ns + int(rng.choice([0, 1.5e8]))) if k % 2 else None
            for k, m in enumerate(m for m in drive if isinstance(m, LaserScan))]  # fmt: skip
    others = [m for m in drive if not isinstance(m, LaserScan)]
    messages = sorted([*filter(None, late), *others], key=lambda m: m.stamp_ns)
    assert findings(messages).keys() <= {"mount-yaw"}
    monkeypatch.setattr(motion_check, "_late_s", lambda judged, fit: 0.0)
    monkeypatch.setattr(motion_check, "_spread", lambda judged, fit, late_s: 1.0)
    assert "wheel-slip" in findings(messages)


@pytest.mark.parametrize("folder", ["neato24-square", "neato24-fsm", "neato18-test",
                                    "neato18-avoid", "tb4-mac"])  # fmt: skip
def test_real_wheels_are_not_accused(folder):
    pytest.importorskip("rosbags", reason="the extra [ros] is not installed")
    source = REAL / folder
    if not source.is_dir():
        pytest.skip(f"recordings of real robots are not at {REAL}")
    source = next(source.glob("*.bag"), source)
    assert findings(message for message, _ in read_any(source).received()) == {}


def test_reversing_that_is_reported_as_going_forward():
    found = findings(office(faults=[OdometryFault("sign-flip", 0.0)]))
    assert found["odometry-sign"].severity == "error"


@pytest.mark.parametrize("degrees", [-4.0, 3.0, 180.0])
def test_a_laser_that_looks_elsewhere_than_the_log_says(degrees):
    turned = office(base_T_laser=Pose2(0.16, 0.0, math.radians(degrees)))
    found = findings(MOUNT if isinstance(m, LaserExtrinsics) else m for m in turned)
    assert found.keys() == {"mount-yaw"}
    finding = found["mount-yaw"]
    assert finding.severity == ("error" if degrees == 180.0 else "warning")
    assert f"looks {degrees:.0f}" in finding.text or abs(degrees) == 180.0


def test_a_laser_that_sits_elsewhere_than_the_log_says(sound):
    found = findings(replace(m, x=-0.1) if isinstance(m, LaserExtrinsics) else m for m in sound)
    assert found.keys() == {"mount-place"}
    assert "(0.16, " in found["mount-place"].text


@pytest.mark.parametrize("factor", [0.485, 1.2])
def test_wheels_counted_in_wrong_units(sound, factor):
    found = findings(with_wheels(sound, lambda m: replace(m, x=factor * m.x, y=factor * m.y)))
    assert found.keys() == {"odometry-scale"}
    assert found["odometry-scale"].severity == ("error" if factor < 0.7 else "warning")
    said = float(found["odometry-scale"].text.split()[3])
    assert said == pytest.approx(1 / factor, rel=0.04)


def test_a_laser_upside_down(sound):
    mirrored = (replace(m, ranges=m.ranges[::-1].copy()) if isinstance(m, LaserScan) else m
                for m in sound)  # fmt: skip
    assert "odometry-turn-sign" in findings(mirrored)


def test_what_cannot_be_judged_is_not_judged(sound):
    nothing = [replace(m, ranges=np.full_like(m.ranges, np.inf)) for m in sound[:900:3]
               if isinstance(m, LaserScan)]  # fmt: skip
    broken = [WheelOdometry(1, math.nan, 0.0, 0.0), LaserExtrinsics(1, math.inf, 0.0, 0.0)]
    for messages in ([], broken, nothing, sound[:60], [*broken, *sound[:60], *sound[:60]]):
        assert findings(messages) == {}


@pytest.mark.parametrize(
    "change",
    [
        {"angle_step": 1e-9}, {"angle_step": -1e-300}, {"angle_min": 1e300}, {"angle_min": -50.0},
        {"range_max": 1e300}, {"range_min": 1e300}, {"range_max": -1.0},
        {"ranges": np.full(181, 1e38, dtype=np.float32)}, {"ranges": np.zeros(1, dtype=np.float32)},
        {"ranges": np.full(181, 1e-30, dtype=np.float32)},
    ],
)  # fmt: skip
def test_scans_that_no_laser_takes_end_in_no_fault(sound, change):
    hostile = [replace(m, **change) if isinstance(m, LaserScan) else m for m in sound[:400]]
    assert findings(hostile).keys() <= {"mount-yaw"}


def test_a_long_log_costs_no_more_than_a_short_one():
    collector = PairCollector(most_moving=8, most_still=2)
    ranges = np.ones(5, dtype=np.float32)
    for k in range(20_000):
        stamp = EPOCH_NS + k * 100_000_000
        x = 0.1 * max(k - 5000, 0)
        collector.feed(WheelOdometry(stamp, x, 0.0, 0.0))
        collector.feed(LaserScan(stamp, -1.0, 0.5, ranges))
    moving, still = collector.moving.pairs(), collector.still.pairs()
    assert len(moving) <= 8 * BLOCK
    assert len(still) <= 2 * BLOCK
    assert collector.moving.seen > 3000
    assert collector.still.seen > 400
    blocks = {pair.serial // BLOCK for pair in moving}
    assert len(np.unique(np.diff(sorted(blocks)))) == 1  # evenly spread
    assert max(blocks) * BLOCK > 0.7 * collector.moving.seen
    assert all(0.29 < pair.distance_m < 0.41 for pair in moving[1:])


def test_blocks_are_kept_whole():
    blocks = Blocks(4)
    collector = [pair(k) for k in range(200)]
    for one in collector:
        blocks.add(one)
    serials = [one.serial for one in blocks.pairs()]
    for start in range(0, len(serials) - BLOCK, BLOCK):
        assert serials[start : start + BLOCK] == list(range(serials[start], serials[start] + BLOCK))


def pair(serial):
    from slam.tools.doctor.motion_pairs import Pair

    scan = LaserScan(serial, 0.0, 0.1, np.ones(2, dtype=np.float32))
    return Pair(serial, scan, scan, Pose2(), 0.3, 0.0, 1.0)


def test_the_fit_finds_what_was_put_in_whatever_a_fifth_of_the_pairs_says():
    rng = np.random.default_rng(4)
    n, scale, turn_scale, yaw, place = 120, 1.25, 0.8, 0.3, 0.2 - 0.1j
    turns, steps = rng.normal(0.0, 0.25, n), rng.normal(0.3, 0.05, n) + 0.0j
    laser = (steps + (np.exp(1j * turns) - 1) * place) * np.exp(-1j * yaw)
    laser += 0.003 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    wheels, wheel_turns = steps / scale, turns / turn_scale + rng.normal(0.0, 0.01, n)
    wheels[:24], wheel_turns[:24] = 0.7j, 1.0
    fit = fit_motion(wheels, wheel_turns, laser, turns, 0.0j)
    assert fit.distance_scale == pytest.approx(scale, abs=0.01)
    assert fit.turn_scale == pytest.approx(turn_scale, abs=0.02)
    assert fit.yaw == pytest.approx(yaw, abs=0.01)
    assert abs(fit.place - place) < 0.02
    assert max(fit.distance_sigma, fit.turn_sigma, fit.yaw_sigma, fit.place_sigma) < 0.02
    straight = fit_motion(steps, 0 * turns, steps * np.exp(-1j * yaw), 0 * turns, 0.16 + 0.0j)
    assert straight.place == pytest.approx(0.16)  # as the log says: nothing tells
    assert straight.place_sigma > 0.2
    assert math.isnan(straight.turn_scale)
