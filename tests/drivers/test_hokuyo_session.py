import math
from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.connection import DeviceEvent
from slam.drivers.errors import LinkLost, NoReply, Refused, WrongDevice
from slam.drivers.hokuyo import HokuyoConfig
from slam.drivers.simulators.drive import BASE_T_LASER, EPOCH_NS
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.laser import LaserConfig, take_scan
from slam.drivers.simulators.link import WireFaults
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.world import World
from slam.logs.messages import LaserScan, RawBytes

ROOM = World.from_polygon([(-3, -2), (6, -2), (6, 2), (2, 2), (2, 3), (-3, 3)])  # the bench's
PAPER = {"angle_min": -math.pi / 2, "angle_max": math.pi / 2, "cluster": 4}


@pytest.mark.parametrize(
    ("model", "beams", "rate"),
    [
        ("urg-04lx", 682, 10),
        ("utm-30lx", 1081, 40),
        ("utm-30lx-ew", 1081, 40),
        ("ust-10lx", 1081, 40),
    ],
)
def test_every_model_streams_at_its_own_geometry_and_rate(laser_bench, model, beams, rate):
    bench = laser_bench(HokuyoBuild(model=model))
    assert "H0000001" in bench.session.connect()
    bench.run(2.0)
    scans = bench.messages(LaserScan)
    assert {scan.ranges.shape for scan in scans} == {(beams,)}
    assert len(scans) == pytest.approx(2.0 * rate, abs=2)
    assert np.diff([s.stamp_ns for s in scans]).mean() == pytest.approx(1e9 / rate, rel=1e-3)
    assert scans[0].angle_step == pytest.approx(
        2 * math.pi / MODELS[model].parameters.steps_per_turn
    )
    bench.session.close()
    assert bench.device.state == "idle"


def test_the_papers_beams_are_seen_where_they_are(laser_bench):
    bench = laser_bench(**PAPER)
    bench.session.connect()
    bench.run(0.5)
    scan = bench.messages(LaserScan)[-1]
    assert scan.ranges.shape == (181,)
    # Clustering takes the smallest of four noisy ranges; else beam 90 looks at x = 6.
    assert scan.ranges[90] == pytest.approx(6.0 - 0.16, abs=0.3)
    assert math.degrees(scan.angle_min + 90 * scan.angle_step) == pytest.approx(0.375)


def test_ranges_are_those_of_the_world_at_the_stamp(laser_bench):
    bench = laser_bench()
    bench.session.connect()
    bench.run(1.0)
    scan = bench.messages(LaserScan)[-1]
    time_s = (scan.stamp_ns - EPOCH_NS) * 1e-9
    laser = LaserConfig(beams=1081, angle_min=scan.angle_min, angle_step=scan.angle_step, sigma=0.0)
    pose = Pose2(0.3 * time_s + BASE_T_LASER.x(), 0.0, 0.0)
    exact = take_scan(ROOM, pose, laser, np.random.default_rng(0)).ranges
    assert np.abs(scan.ranges - exact).max() < 0.06
    assert np.std(scan.ranges - exact) == pytest.approx(0.010, rel=0.15)


def test_intensity_skip_and_short_codes_change_what_is_asked(laser_bench):
    for config, symbol, rate in (
        ({"intensity": True}, b"ME", 40),
        ({"skip": 3}, b"MD", 10),
        ({"short_codes": True}, b"MS", 40),
    ):
        bench = laser_bench(**config)
        bench.session.connect()
        bench.run(2.0)
        assert symbol + b"00001080" in bench.sent()
        assert len(bench.messages(LaserScan)) == pytest.approx(2.0 * rate, abs=2)
        assert bench.session.decoder.counters()["missing_scans"] == 0


def test_free_space_is_inf_and_errors_are_nan(laser_bench):
    for model in ("utm-30lx", "ust-10lx", "urg-04lx"):
        bench = laser_bench(HokuyoBuild(model=model))
        open_air = World.from_polygon([(0.165, 1), (0.165, -1), (0.17, -1), (0.17, 1)])
        still = bench.device._sweeper._motion
        still.starts_s = 1e9
        device = HokuyoDevice(Sweeper(MODELS[model], open_air, still), bench.device.build)
        bench.line.device = device
        bench.session.connect()
        bench.run(0.3)
        ranges = bench.messages(LaserScan)[0].ranges
        front = len(ranges) // 2
        assert np.isnan(ranges[front])  # a wall 5 mm ahead
        behind = ranges[5]
        assert np.isnan(behind) if model == "urg-04lx" else np.isinf(behind)


@pytest.mark.parametrize("drift", [-100e-6, 50e-6])
def test_stamps_follow_the_true_sweeps_within_a_millisecond(laser_bench, drift):
    build = HokuyoBuild(clock_rate=1.0 + drift, clock_start=(1 << 24) - 5000)
    bench = laser_bench(build, faults=WireFaults(delay_s=0.004), **PAPER)
    bench.session.connect()
    bench.run(25.0)
    stamps = np.array([s.stamp_ns - EPOCH_NS for s in bench.messages(LaserScan)]) * 1e-9
    period = 0.025 / build.clock_rate
    first = 181.5 / 1440 * period
    errors = stamps - first - np.round((stamps - first) / period) * period
    assert np.abs(errors).max() < 3e-3  # sync through up to 4 ms of jitter
    assert len(stamps) == pytest.approx(1000, abs=3)


def test_a_sensor_that_streams_from_a_killed_client_is_calmed_first(laser_bench):
    bench = laser_bench()
    bench.line.to_device(b"ME0000108001000\n", 0.0, 0)
    bench.time.sleep(1.0)
    bench.session.connect()
    counters = bench.session.decoder.counters()
    assert counters["foreign_scans"] > 0
    assert not any(name.startswith("lost_") for name in counters)  # none of ours is missing
    bench.run(1.0)
    assert bench.session.decoder.scans == pytest.approx(40, abs=2)


JUMPS = [1_000_000, 20_000, -3_000, -20_000, 8_000_000]


# Ahead by less than 5 s cannot be told before the clock has settled.
@pytest.mark.parametrize(("at_s", "jump_ms"), [*((5.0, j) for j in JUMPS), (25.0, 3_000)])
def test_a_clock_that_jumps_loses_three_scans_and_no_more(laser_bench, jump_ms, at_s):
    build = HokuyoBuild(clock_start=9_000_000, clock_jumps=((at_s, jump_ms),))
    bench = laser_bench(build, **PAPER, skip=3)
    bench.session.connect()
    bench.run(at_s + 5.0)
    counters = bench.session.decoder.counters()
    assert counters["missing_scans"] <= 1
    assert counters["outage_scans"] <= 1
    assert counters.get("lost_impossible_time", 0) <= 3
    stamps = [s.stamp_ns for s in bench.messages(LaserScan)]
    assert (stamps[-1] - EPOCH_NS) * 1e-9 == pytest.approx(bench.time.now_s, abs=0.15)


def test_a_motor_that_takes_three_seconds_to_spin_up_is_waited_for(laser_bench):
    bench = laser_bench(HokuyoBuild(spin_up_s=3.0))
    assert bench.session.connect().startswith("connected")
    assert bench.time.now_s > 3.0
    assert bench.session.decoder.scans == 1  # connected means that it measures
    assert bench.sent().count(b"MD0000108001000") == 1
    bench.run(1.0)


def notices(bench):
    return [event.detail for event in bench.messages(DeviceEvent) if event.kind == "notice"]


@pytest.mark.parametrize("begin", [0.0, 3.0])
def test_a_sensor_that_checks_itself_is_left_alone_and_told_once(laser_bench, begin):
    bench = laser_bench(HokuyoBuild(checks=((begin, begin + 5.0),), check_status="35"), **PAPER)
    bench.session.connect()
    bench.run(9.0)
    assert bench.sent().count(b"MD0180090004000") == 1
    assert notices(bench) == [
        "sensor has stopped to check itself (35)",
        "sensor has checked itself and scans again",
    ]
    assert bench.session.decoder.scans > 100


def test_a_check_without_an_end_is_given_up(laser_bench):
    bench = laser_bench(HokuyoBuild(checks=((0.0, 1e9),)), **PAPER)
    with pytest.raises(NoReply, match=r"it answers instead: sensor has stopped to check itself"):
        bench.session.connect()
    assert 60.0 < bench.time.now_s < 90.0


def test_another_status_in_place_of_scans_is_named(laser_bench):
    bench = laser_bench(HokuyoBuild(checks=((2.0, 1e9),), check_status="0E"))
    bench.session.connect()
    with pytest.raises(
        NoReply, match=r"no scan from the laser for 1\.0 s; it answers instead: unk"
    ):
        bench.run(10.0)


def test_a_half_line_of_an_earlier_client_does_no_harm(laser_bench):
    bench = laser_bench()
    bench.line.to_device(b"MD00001", 0.0, 0)
    bench.session.connect()


def test_a_sensor_left_in_clock_mode_is_led_out_of_it(laser_bench):
    bench = laser_bench()
    bench.line.to_device(b"TM0\n", 0.0, 0)
    bench.session.connect()
    assert bench.device.state == "stream"


def test_an_old_urg_is_told_to_speak_scip_2(laser_bench):
    bench = laser_bench(HokuyoBuild(model="urg-04lx"))
    bench.session.connect()
    assert b"SCIP2.0\n" in bench.sent()


def test_a_damaged_version_is_not_fatal(laser_bench):
    bench = laser_bench(HokuyoBuild(damaged_version=True))
    bench.session.connect()
    assert "PROD" not in bench.session.decoder.version


def test_questions_are_asked_once_and_never_while_streaming(laser_bench):
    bench = laser_bench()
    bench.session.connect()
    bench.run(1.0)
    lines = bench.sent().split(b"\n")
    assert [lines.count(q) for q in (b"VV", b"II", b"PP")] == [1, 1, 1]
    assert lines.index(b"PP") < lines.index(b"TM0") < lines.index(b"MD0000108001000")


def test_a_sensor_that_denies_the_clock_is_used_all_the_same(laser_bench):
    bench = laser_bench(HokuyoBuild(allows_sync=False))
    bench.session.connect()
    bench.run(2.0)
    assert not bench.session.decoder.clock.synchronised
    assert bench.session.decoder.scans == pytest.approx(80, abs=2)


def test_a_booting_sensor_is_silent_then_there(laser_bench):
    bench = laser_bench(HokuyoBuild(boot_s=10.0), serial=False)
    with pytest.raises(NoReply, match="30 s after power-on"):
        bench.session.connect()
    bench.session.drop()
    bench.time.sleep(10.0)
    bench.session.connect()


def test_the_speed_of_a_serial_urg_is_found(laser_bench):
    build = HokuyoBuild(model="urg-04lx")
    bench = laser_bench(build, serial=True, baud=115200, short_codes=True, cluster=2)
    bench.session.connect()
    bench.run(5.0)
    assert bench.session.decoder.scans > 8  # 19200 baud carries two to three such scans a second
    assert bench.session.decoder.counters()["missing_scans"] > 0


def test_a_fault_of_the_sensor_has_its_name(laser_bench):
    bench = laser_bench(HokuyoBuild(fault_at_s=2.0))
    bench.session.connect()
    with pytest.raises(Refused, match=r"fault 50\. Its own words, asked after that: Laser malf"):
        bench.run(10.0)


def test_silence_is_noticed_within_its_time(laser_bench):
    bench = laser_bench(faults=WireFaults(silences=((3.0, 100.0),)))
    bench.session.connect()
    with pytest.raises(NoReply, match="no scan"):
        bench.run(60.0)
    assert bench.time.now_s < 4.5


def test_an_unplugged_sensor_that_goes_on_is_taken_up(laser_bench):
    bench = laser_bench(faults=WireFaults(unplugged=((3.0, 4.0),)), **PAPER)
    bench.session.connect()
    with pytest.raises(LinkLost):
        bench.run(60.0)
    bench.session.drop()
    bench.time.sleep(1.1)
    assert bench.session.connect().startswith("resumed")
    bench.run(1.0)
    counters = bench.session.decoder.counters()
    assert counters["missing_scans"] == pytest.approx(41, abs=5)
    assert counters["clock_restarts"] == 1  # of the first connection


def test_a_reboot_starts_the_clock_again(laser_bench):
    bench = laser_bench(HokuyoBuild(reboots=((5.0, 1.0),), clock_start=9_000_000), **PAPER)
    bench.session.connect()
    with pytest.raises(NoReply):
        bench.run(60.0)
    bench.session.drop()
    assert bench.session.connect().startswith("connected")
    bench.run(2.0)
    stamps = [s.stamp_ns for s in bench.messages(LaserScan)]
    assert (stamps[-1] - EPOCH_NS) * 1e-9 == pytest.approx(bench.time.now_s, abs=0.06)
    assert stamps == sorted(stamps)


def test_damage_on_the_wire_costs_scans_but_never_makes_one_up(laser_bench):
    clean = laser_bench(**PAPER)
    noisy = laser_bench(faults=WireFaults(flip_rate=2e-4, loss_rate=1e-4, seed=3), **PAPER)
    truth = {}
    for bench in (clean, noisy):
        bench.session.connect()
        bench.run(20.0)
    for scan in clean.messages(LaserScan):
        truth[scan.ranges.tobytes()] = scan
    scans = noisy.messages(LaserScan)
    counters = noisy.session.decoder.counters()
    made_up = [s for s in scans if s.ranges.tobytes() not in truth]
    assert 300 < len(scans) < 790
    lost = sum(n for cause, n in counters.items() if cause.startswith("lost_"))
    assert counters["missing_scans"] + lost + len(scans) == pytest.approx(800, abs=12)
    assert len(made_up) <= 2  # six bits of sum let one in 64 of doubly damaged lines through


def test_no_sensor_and_no_parameters_are_told_as_such(laser_bench, monkeypatch):
    bench = laser_bench(faults=WireFaults(silences=((0.0, 1e9),)))
    with pytest.raises(NoReply, match="powered"):
        bench.session.connect()
    bench = laser_bench()
    monkeypatch.setattr("slam.drivers.simulators.hokuyo_device.parameters", lambda model: [])
    with pytest.raises(WrongDevice, match="no parameters"):
        bench.session.connect()


@pytest.mark.parametrize(
    "wrong",
    [
        {"cluster": 100},
        {"skip": 10},
        {"angle_min": 1.0, "angle_max": 0.0},
        {"reach_m": 0.0},
        {"intensity": True, "short_codes": True},
    ],
)
def test_settings_that_scip_cannot_express_are_refused(wrong):
    with pytest.raises(ValueError, match=r"need|intensities"):
        HokuyoConfig(port="x", **wrong)


def test_raw_bytes_of_both_directions_are_kept(laser_bench):
    bench = laser_bench()
    bench.session.connect()
    raw = bench.messages(RawBytes)
    assert {r.direction for r in raw} == {"rx", "tx"}
    assert all(a.stamp_ns <= b.stamp_ns for a, b in pairwise(raw))
