"""What users and foreign programs have run into (docs/devices.md), where no other test has it."""

import numpy as np
import pytest
from slam.drivers.arcos_protocol import Framer, Id, encode_command, encode_packet
from slam.drivers.arcos_reports import (
    CONFIG,
    ENCODER,
    IO,
    STANDARD,
    Identity,
    StandardReport,
    decode_config,
    encode_identity,
    encode_standard,
)
from slam.drivers.errors import NoReply, WrongDevice
from slam.drivers.hokuyo import Hokuyo, HokuyoConfig
from slam.drivers.pioneer import Pioneer, PioneerConfig
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.scip_protocol import checksum, encode_reply
from slam.drivers.simulators.hokuyo_device import HokuyoBuild
from slam.drivers.simulators.link import SimulatedTime
from slam.logs.messages import LaserScan, RawBytes, WheelOdometry

MS = 1_000_000


def test_commands_leave_the_firmware_time(robot_bench):
    """Its command loop runs at 1 kHz: commands closer than 3 to 5 ms may be dropped."""
    bench = robot_bench()
    bench.session.connect()
    bench.run(2.0)
    sent = [m.stamp_ns for m in bench.messages(RawBytes) if m.direction == "tx"]
    assert np.diff(sent).min() >= 4.9 * MS


def test_arias_modem_words_before_sync0_are_skipped(robot_bench):
    bench = robot_bench()
    bench.line.to_device(b"WMS2\r" + encode_command(0), 0.0, 9600)
    assert [command.id for command in bench.device.commands] == [0]


def packets(bench, seconds, baud=9600):
    """All that comes within so many seconds of simulated time."""
    framer, end, found = Framer(), bench.time.now_s + seconds, []
    while bench.time.now_s < end:
        bench.time.sleep(0.01)
        found += framer.feed(bench.line.to_host(bench.time.now_s, baud), bench.time())
    return found


def tell(bench, number, argument=None, baud=9600):
    bench.line.to_device(encode_command(number, argument), bench.time.now_s, baud)


def test_aria_finds_what_it_waits_for_at_every_step(robot_bench):
    """Its sequence on a serial line (section 1.3), with the answers that its source reads."""
    bench = robot_bench()
    bench.line.to_device(b"WMS2\r", 0.0, 9600)
    for stage in (0, 1, 2):
        tell(bench, stage)
        [answer] = packets(bench, 0.1)
        assert answer.id == stage
    assert answer.payload[1:].split(b"\0")[1:] == [b"Pioneer", b"p3dx-sh", b""]
    tell(bench, Id.OPEN, 1)
    tell(bench, Id.CONFIG, 1)
    [config] = [decode_config(p.payload) for p in packets(bench, 1.0) if p.id == CONFIG]
    assert config.auto_baud == 2  # so it asks for the speed of its parameter file
    tell(bench, Id.HOSTBAUD, 2)
    bench.time.sleep(0.02)
    tell(bench, Id.PULSE, baud=38400)
    assert {p.id for p in packets(bench, 0.9, 38400)} <= set(STANDARD)
    for number, argument in (
        (Id.BATTERYINFO, 1), (Id.SETV, 3000), (Id.SETA, 300), (Id.SETA, -300), (Id.SETRV, 150),
        (Id.SETRA, 100), (Id.SETRA, -100), (Id.ENCODER, 2), (Id.IOREQUEST, 2), (Id.ENABLE, 1),
    ):  # fmt: skip
        tell(bench, number, argument, 38400)
    ids = [p.id for p in packets(bench, 1.0, 38400)]
    # Encoders and inputs come behind the standard report of their cycle.
    first = next(i for i, number in enumerate(ids) if number == ENCODER)
    assert ids[first - 1] in STANDARD
    assert ids[first + 1] == IO
    tell(bench, Id.CLOSE, 1, 38400)
    packets(bench, 0.2, 38400)
    assert packets(bench, 1.0) == []
    assert bench.device.baud == 9600  # an AutoBaud robot falls back


def test_aria_closes_a_robot_that_was_left_open(robot_bench):
    """It answers SYNC0 with a report, is told CLOSE with a number, and begins anew."""
    bench = robot_bench()
    for number in (0, 1, 2, 1):
        tell(bench, number)
    packets(bench, 0.5)
    tell(bench, 0)
    assert packets(bench, 0.3)[0].id in STANDARD
    tell(bench, Id.CLOSE, 1)
    packets(bench, 0.2)
    for stage in (0, 1, 2):
        tell(bench, stage)
        assert [p.id for p in packets(bench, 0.1)] == [stage]


def test_aria_dislodging_a_robot_that_is_not_connected_does_no_harm(robot_bench):
    """After silences it sends CLOSE at all speeds, and OPEN: to this robot SYNC2 and SYNC1."""
    bench = robot_bench()
    for baud in (9600, 38400, 115200, 19200, 57600):
        tell(bench, Id.CLOSE, 1, baud)
    tell(bench, Id.OPEN, 1)
    packets(bench, 0.5)
    for stage in (0, 1, 2):
        tell(bench, stage)
        assert [p.id for p in packets(bench, 0.1)] == [stage]


def test_aria_reads_an_old_urg(laser_bench):
    """Its SCIP 2.0 class: RS and SCIP2.0 blindly, then VV, PP and MD; AMIN must not be 0."""
    bench = laser_bench(HokuyoBuild(model="urg-04lx"))

    def say(line):
        bench.line.to_device(line + b"\n", bench.time.now_s, 19200)
        bench.time.sleep(0.1)
        return bench.line.to_host(bench.time.now_s, 19200).split(b"\n")

    assert say(b"RS") == [b"RS", b"E", b"", b""]
    assert say(b"SCIP2.0") == [b"SCIP2.0", b"00P", b"", b""]
    for question, first, lines in ((b"VV", b"VEND:", 5), (b"PP", b"MODL:", 8)):
        echo, status, *found, empty, _ = say(question)
        assert (echo, status, empty, len(found)) == (question, b"00P", b"", lines)
        assert found[0].startswith(first)
        assert all(line[-2:-1] == b";" and checksum(line[:-2]) == line[-1] for line in found)
    assert int(found[4].removeprefix(b"AMIN:")[:-2]) > 0
    request = b"MD0128064004000"
    assert say(request)[:3] == [request, b"00P", b""]
    bench.time.sleep(0.2)
    echo, status, stamp, *data = (
        bench.line.to_host(bench.time.now_s, 19200).split(b"\n\n")[0].split(b"\n")
    )
    assert (echo, status, len(stamp)) == (request, b"99b", 5)
    assert sum(len(line) - 1 for line in data) == 3 * 129  # 513 steps in fours
    assert say(b"RS")[-4:] == [b"RS", b"00P", b"", b""]


def test_a_laser_that_answers_while_it_boots_is_there_afterwards(laser_bench):
    bench = laser_bench(HokuyoBuild(boot_s=3.0, boot_status="0M"))
    with pytest.raises(NoReply):
        bench.session.connect()
    bench.session.drop()
    bench.time.sleep(3.0)
    bench.session.connect()
    bench.run(1.0)
    assert len(bench.messages(LaserScan)) > 30


class Script:
    """A port that answers each line from a list, and adds what a broken link would."""

    name, has_baud = "script", False

    def __init__(self, time, answer):
        self.time, self.answer, self.waiting = time, answer, b""

    def read(self, timeout_s):
        self.time.sleep(0.001 if self.waiting else timeout_s)
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data):
        self.waiting += self.answer(data)

    def set_baud(self, baud):
        pass

    def close(self):
        pass


def test_a_line_that_echoes_what_is_sent_does_not_confuse_the_laser(laser_bench):
    """A CDC port with its echo left on, as on one boot in ten."""
    bench = laser_bench()

    def echoing(data):
        bench.line.to_device(data, bench.time.now_s, 0)
        return data

    class Echo(Script):
        def read(self, timeout_s):
            data = super().read(0.001)
            return data + bench.line.to_host(bench.time.now_s, 0)

    session = Hokuyo(HokuyoConfig(port="echo"), bench.received.append, bench.time,
                     lambda name, baud: Echo(bench.time, echoing))  # fmt: skip
    session.connect()
    end = bench.time.now_s + 1.0
    while bench.time.now_s < end:
        session.poll()
    assert len(bench.messages(LaserScan)) > 30


def test_a_loop_back_plug_is_no_robot():
    time = SimulatedTime()
    session = Pioneer(PioneerConfig(port="loop"), lambda received: None, time,
                      lambda name, baud: Script(time, lambda data: data))  # fmt: skip
    with pytest.raises((WrongDevice, NoReply)):
        session.connect()


def test_a_stale_answer_is_not_taken_for_the_next_one():
    """After an error urg_library before 2025-08 read the old QT as the answer to GD."""
    time, asked = SimulatedTime(), []

    def answer(data):
        asked.append(data)
        line = data.strip()
        stale = encode_reply(b"QT", "00")
        return stale + (encode_reply(line, "00") if line == b"QT" else b"")

    session = Hokuyo(HokuyoConfig(port="stale"), lambda received: None, time,
                     lambda name, baud: Script(time, answer))  # fmt: skip
    with pytest.raises(WrongDevice, match="no parameters"):
        session.connect()
    assert [line for line in asked if line.startswith(b"PP")]
    assert session.decoder.parameters is None


def test_a_step_of_more_than_100_mm_is_motion_all_the_same():
    """Where p2os drops such a step, after a serial line has stalled, motion is lost silently."""
    decoder, found = PioneerDecoder(), []
    wire = encode_packet(encode_identity(Identity("a", "Pioneer", "p3dx-sh")))
    for x in (0, 50, 450, 500):
        wire = wire + encode_packet(encode_standard(StandardReport(x=x)))
        found += decoder.decode(RawBytes((x + 1) * 2 * MS, "p3dx", "rx", wire))
        wire = b""
    assert [m.x for m in found if isinstance(m, WheelOdometry)] == pytest.approx(
        [0.0, 0.05, 0.45, 0.5]
    )
    assert decoder.counters()["odometry_jumps"] == 0


def test_a_confused_robot_is_synchronised_anew(robot_bench):
    """0xFF answers a SYNC in the wrong order."""
    bench = robot_bench()
    for number in (0, 2):
        bench.line.to_device(encode_command(number), bench.time.now_s, 9600)
    bench.session.connect()
    assert bench.device.sending
    assert Id.OPEN in [command.id for command in bench.device.commands]
