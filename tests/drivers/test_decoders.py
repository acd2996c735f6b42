import math
from dataclasses import replace

import numpy as np
import pytest
from slam.drivers.arcos_protocol import encode_command, encode_packet
from slam.drivers.arcos_reports import Identity, StandardReport, encode_identity, encode_standard
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import MODELS, PioneerDecoder
from slam.drivers.scip_protocol import encode_number, encode_reply, information_line, with_sum
from slam.drivers.scip_scan import ScanRequest, encode_scan
from slam.logs.messages import LaserScan, RawBytes, WheelOdometry

EPOCH = 1_700_000_000_000_000_000
CYCLE = 100_000_000
MS = 1_000_000


def rx(data, at_ns, device="p3dx"):
    return RawBytes(EPOCH + at_ns, device, "rx", data)


def tx(data, at_ns, device="p3dx"):
    return RawBytes(EPOCH + at_ns, device, "tx", data)


class Robot:
    """Feeds reports to a decoder, one a cycle."""

    def __init__(self, subclass="p3dx-sh"):
        self.decoder, self.now = PioneerDecoder(), 0
        self.name(subclass)

    def name(self, subclass="p3dx-sh"):
        identity = Identity("robot", "Pioneer", subclass)
        list(self.decoder.decode(rx(encode_packet(encode_identity(identity)), self.now)))

    def at(self, x, y=0, theta=0, cycles=1):
        self.now += cycles * CYCLE
        packet = encode_packet(encode_standard(StandardReport(x=x, y=y, theta=theta)))
        [odometry] = self.decoder.decode(rx(packet, self.now))
        return odometry


def test_odometry_starts_at_zero_whatever_the_robot_has_counted():
    robot = Robot()
    assert robot.at(12345, -99, 1024) == WheelOdometry(EPOCH + CYCLE, 0.0, 0.0, 0.0)
    moved = robot.at(12345, 1, 1024)  # 0.1 m along the robot's y, which is where it looks
    assert (moved.x, moved.y, moved.theta) == pytest.approx((0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("subclass", "metres"), [("p3dx-sh", 0.1), ("P3DX-SH", 0.1), ("p3dx", 0.0485)]
)
def test_the_subclass_selects_the_factors(subclass, metres):
    robot = Robot(subclass)
    robot.at(0)
    assert robot.at(100).x == pytest.approx(metres)


def test_a_robot_of_unknown_factors_gives_no_odometry():
    decoder = PioneerDecoder()
    packet = encode_packet(encode_standard(StandardReport()))
    assert list(decoder.decode(rx(packet, 0))) == []
    assert decoder.model is None


@pytest.mark.parametrize("wrap", [0x8000, 0x10000])  # ARCOS, AMRISim
@pytest.mark.parametrize("step", [150, -150])
def test_position_counters_wrap(wrap, step):
    robot, x = Robot(), 0
    start = robot.at(0).x
    for _ in range(1000):
        x += step
        last = robot.at((x + wrap // 2) % wrap - wrap // 2 if wrap == 0x10000 else x % wrap)
    assert last.x - start == pytest.approx(step)
    assert robot.decoder.jumps == 0


@pytest.mark.parametrize("offset", [0, 2048])  # signed, and 0 to 4095 as in old P2OS
def test_headings_wrap(offset):
    robot, theta = Robot(), 0
    robot.at(0, 0, offset)
    for _ in range(100):
        theta += 100
        last = robot.at(0, 0, (theta + offset) % 4096 if offset else (theta + 2048) % 4096 - 2048)
    assert last.theta == pytest.approx(math.remainder(10_000 * MODELS["p3dx-sh"].radians, math.tau))
    assert -math.pi <= last.theta <= math.pi


def test_a_short_gap_loses_no_motion_a_long_one_is_not_guessed_at():
    robot = Robot()
    robot.at(0)
    assert robot.at(1500, cycles=20).x == pytest.approx(1.5)  # 2 s at 0.75 m/s
    assert robot.at(5000, cycles=100).x == pytest.approx(1.5)  # 10 s: the count may have wrapped
    assert robot.decoder.jumps == 1
    assert robot.at(5100).x == pytest.approx(1.6)


def test_a_jump_no_robot_can_make_is_counted_and_left_out():
    robot = Robot()
    robot.at(0)
    robot.at(100)
    assert robot.at(10_000).x == pytest.approx(0.1)
    assert robot.at(10_100).x == pytest.approx(0.2)
    assert robot.decoder.counters()["odometry_jumps"] == 1


def test_after_a_new_connection_the_pose_goes_on_in_its_own_direction():
    robot = Robot()
    robot.at(0, 0, 0)
    robot.at(100, 0, 512)
    robot.at(100, 0, 1024)  # looking along y
    robot.name()  # SYNC2 is answered: the robot has been switched off and on
    before = robot.at(0, 0, 0)
    after = robot.at(100, 0, 0)
    assert before.theta == after.theta == pytest.approx(math.pi / 2)
    assert (after.x - before.x, after.y - before.y) == pytest.approx((0.0, 0.1))
    assert robot.decoder.counters()["odometry_restarts"] == 1


def test_a_command_that_zeroes_the_robots_odometry_is_no_motion():
    robot = Robot()
    robot.at(0)
    robot.at(200)
    list(robot.decoder.decode(tx(encode_command(7), robot.now)))
    assert robot.at(0).x == pytest.approx(0.2)
    assert robot.decoder.jumps == 0


def test_odometry_is_stamped_with_the_first_byte():
    decoder = Robot().decoder
    packet = encode_packet(encode_standard(StandardReport()))
    assert list(decoder.decode(rx(packet[:5], CYCLE))) == []
    [odometry] = decoder.decode(rx(packet[5:], CYCLE + 30 * MS))
    assert odometry.stamp_ns == EPOCH + CYCLE


def test_a_damaged_report_moves_nothing():
    robot = Robot()
    robot.at(0)
    packet = bytearray(encode_packet(encode_standard(StandardReport(x=100))))
    for at in range(4, len(packet)):
        damaged = bytearray(packet)
        damaged[at] ^= 0x10
        robot.now += MS
        assert list(robot.decoder.decode(rx(bytes(damaged), robot.now))) == []
    assert robot.decoder.counters()["bad_checksums"] == len(packet) - 4
    assert robot.at(100).x == pytest.approx(0.1)


PARAMETERS = {
    "MODL": "UTM-30LX", "DMIN": "23", "DMAX": "60000", "ARES": "1440",
    "AMIN": "0", "AMAX": "1080", "AFRT": "540", "SCAN": "2400",
}  # fmt: skip
PAPER = ScanRequest("MD", 180, 900, 4)


def laser_with_parameters(**changes):
    decoder = HokuyoDecoder()
    lines = [information_line(*item) for item in (PARAMETERS | changes).items()]
    list(decoder.decode(rx(encode_reply(b"PP", "00", lines), 0, "laser")))
    return decoder


def report(count, request=PAPER, fill=1000, status="99"):
    distances = np.full(request.values, fill, np.int32)
    return encode_reply(request.encode(), status, encode_scan(count, distances, 3))


def test_the_geometry_is_the_sensors():
    decoder = laser_with_parameters()
    [scan] = decoder.decode(rx(report(500), 40 * MS, "laser"))
    assert isinstance(scan, LaserScan)
    assert scan.ranges.shape == (181,)
    assert math.degrees(scan.angle_min) == pytest.approx(-90.0 + 0.375)  # middle of four steps
    assert math.degrees(scan.angle_step) == pytest.approx(1.0)
    assert scan.beam_period_s == pytest.approx(4 * 0.025 / 1440)
    assert (scan.range_min, scan.range_max) == pytest.approx((0.023, 60.0))
    [full] = decoder.decode(rx(report(600, ScanRequest("MD", 0, 1080)), 140 * MS, "laser"))
    assert math.degrees(full.angle_min) == pytest.approx(-135.0)


def test_the_stamp_is_that_of_the_first_beam():
    decoder = laser_with_parameters()
    list(decoder.decode(tx(b"TM0\n", 0, "laser")))
    list(decoder.decode(tx(b"TM1\n", 1 * MS, "laser")))
    answer = encode_reply(b"TM1", "00", [with_sum(encode_number(1000, 4))])
    list(decoder.decode(rx(answer, 2 * MS, "laser")))
    [scan] = decoder.decode(rx(report(1100), 130 * MS, "laser"))
    first = (180 + 1.5) * 25.0 / 1440
    assert (scan.stamp_ns - EPOCH) / MS == pytest.approx(1.5 + 100.0 + first, abs=0.01)


def test_a_scan_before_the_parameters_is_counted_not_guessed_at():
    decoder = HokuyoDecoder()
    assert list(decoder.decode(rx(report(500), 0, "laser"))) == []
    assert decoder.counters()["lost_without_parameters"] == 1


def test_damaged_parameters_are_not_used():
    decoder = HokuyoDecoder()
    lines = [information_line(*item) for item in PARAMETERS.items()]
    lines[2] = lines[2].replace(b"60000", b"80000")
    list(decoder.decode(rx(encode_reply(b"PP", "00", lines), 0, "laser")))
    assert decoder.parameters is None
    assert decoder.counters()["lost_damaged_parameters"] == 1


def test_every_lost_scan_is_counted_with_its_cause():
    decoder = laser_with_parameters()
    wire = [report(1000 + 25 * k) for k in range(10)]
    wire[3] = wire[3].replace(b"0", b"1", 1)  # the echo: another request, so another length
    wire[5] = wire[5][:-20] + b"x" + wire[5][-19:]
    wire[7] = b""
    wire[8] = report(1200, status="0M")
    scans = [
        s for k, d in enumerate(wire) for s in decoder.decode(rx(d, (40 + 25 * k) * MS, "laser"))
    ]
    counters = decoder.counters()
    assert len(scans) == counters["scans"] == 6
    assert counters["missing_scans"] == 1  # the one that left no trace
    assert counters["lost_damaged"] == 2
    assert counters["lost_status_0M"] == 1


def test_a_cluster_of_none_is_one_step():
    decoder = laser_with_parameters()
    [scan] = decoder.decode(rx(report(1, ScanRequest("MD", 0, 1080, 0)), 40 * MS, "laser"))
    assert scan.ranges.shape == (1081,)


def test_steps_the_sensor_does_not_have_are_damage():
    decoder = laser_with_parameters(AMAX="800")
    assert list(decoder.decode(rx(report(1), 40 * MS, "laser"))) == []


def test_a_replay_of_the_bytes_gives_the_same_messages(laser_bench, robot_bench):
    for bench, decoder in (
        (laser_bench(cluster=4), HokuyoDecoder()),
        (robot_bench(), PioneerDecoder()),
    ):
        bench.session.connect()
        bench.run(3.0)
        bench.session.close()
        live = bench.messages(LaserScan) + bench.messages(WheelOdometry)
        again = [m for raw in bench.messages(RawBytes) for m in decoder.decode(raw)]
        assert len(again) == len(live) > 20
        for a, b in zip(live, again, strict=True):
            if isinstance(a, LaserScan):
                assert (a.stamp_ns, a.ranges.tobytes()) == (b.stamp_ns, b.ranges.tobytes())
            else:
                assert a == b


def test_captured_sessions_decode_whole(capture):
    for name, beams in (("utm_30lx", 1081), ("urg_04lx", 682), ("uxm_30lx_e", 761)):
        decoder = HokuyoDecoder()
        wire = capture(f"example_{name}.logr.raw")
        [scan] = decoder.decode(rx(wire, 10**9, "laser"))
        assert scan.ranges.shape == (beams,)
        assert decoder.counters() == {
            "scans": 1,
            "missing_scans": 0,
            "outage_scans": 0,
            "foreign_scans": 0,
            "skipped_bytes": 0,
            "moved_stamps": 0,
            "clock_restarts": 0,
            "distrusted_syncs": 0,
        }
        assert replace(decoder.parameters, model="").steps_per_turn in (1024, 1440)


def test_scans_of_an_outage_are_counted_over_a_new_start_of_the_clock():
    decoder = laser_with_parameters()
    first = list(decoder.decode(rx(report(1000), 40 * MS, "laser")))
    list(decoder.decode(RawBytes(900 * MS, "laser", "tx", b"TM0\n")))
    second = list(decoder.decode(rx(report(0), 1040 * MS, "laser")))
    assert len(first) == len(second) == 1
    assert decoder.counters()["missing_scans"] == 0
    assert decoder.counters()["outage_scans"] == 39
