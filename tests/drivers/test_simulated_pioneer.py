import numpy as np
import pytest
from slam.drivers.arcos_protocol import Framer, Id, encode_command, encode_packet, vel2_argument
from slam.drivers.arcos_reports import (
    CONFIG,
    ENCODER,
    IO,
    STANDARD,
    IoReport,
    decode_config,
    decode_encoders,
    decode_identity,
    decode_io,
    decode_standard,
)
from slam.drivers.simulators.drive import dead_reckoning
from slam.drivers.simulators.faults import TRACK_WIDTH_M, OdometryFault
from slam.drivers.simulators.motion import CommandedMotion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.robot import ODOMETRY_NOISE, track_of


class Client:
    """Talks to a device byte by byte, without any of the drivers' sessions."""

    def __init__(self, build=None, motion=None):
        self.motion = motion or CommandedMotion()
        self.device, self.framer, self.now = PioneerDevice(self.motion, build), Framer(), 0.0

    def say(self, *packets):
        for packet in packets:
            self.device.receive(packet, self.now)
        return self.wait(0.0)

    def wait(self, seconds):
        got, end = [], self.now + seconds
        while True:
            got += self.framer.feed(self.device.advance(self.now), round(self.now * 1e9))
            if self.now >= end - 1e-9:
                return got
            self.now = min(end, self.now + 0.05)

    def connect(self):
        answers = self.say(*(encode_command(n) for n in (0, 1, 2)))
        self.say(encode_command(Id.OPEN))
        return answers


def ids(packets):
    return [p.id for p in packets]


def test_the_handshake_names_the_robot():
    answers = Client().connect()
    assert ids(answers) == [0, 1, 2]
    assert decode_identity(answers[2].payload).subclass == "p3dx-sh"


@pytest.mark.parametrize("junk", [b"WMS2\r", b"\xfa\xfb\x09\x01", b"\nQT\n", bytes(50)])
def test_junk_before_the_sync_is_skipped(junk):
    client = Client()
    assert ids(client.say(junk + encode_command(0) * 3)[-1:]) == [0]


def test_syncs_out_of_order_are_told_as_such():
    client = Client()
    assert ids(client.say(encode_command(1), encode_command(2))) == []
    assert ids(client.say(encode_command(0), encode_command(2))) == [0, 0xFF]
    assert ids(client.say(encode_command(0), encode_command(1), encode_command(2))) == [0, 1, 2]


def test_a_second_sync2_closes():
    client = Client()
    client.connect()
    assert client.device.connected
    client.say(encode_command(2))
    assert not client.device.connected
    assert client.wait(1.0) == []


@pytest.mark.parametrize("argument", [None, 1])
def test_open_comes_with_and_without_a_number(argument):
    client = Client()
    client.say(*(encode_command(n) for n in (0, 1, 2)))
    assert client.wait(1.0) == []
    client.say(encode_command(Id.OPEN, argument))
    assert set(ids(client.wait(1.0))) <= set(STANDARD)


def test_reports_come_every_cycle_with_sonar_until_it_is_switched_off():
    client = Client()
    client.connect()
    reports = client.wait(1.0)
    assert len(reports) == pytest.approx(10, abs=1)
    assert len(reports[0].payload) == 89 - 5  # AMRISim's length with 16 sonars
    client.say(encode_command(Id.SONAR, 0))
    assert len(client.wait(1.0)[-1].payload) == 41 - 5


def test_motion_obeys_only_with_motors_on_and_within_limits():
    client = Client(PioneerBuild(motors_enabled=False))
    client.connect()
    client.say(encode_command(Id.VEL, 500))
    client.wait(1.0)
    assert client.motion.speeds(client.now) == (0.0, 0.0)
    client.say(encode_command(Id.ENABLE, 1), encode_command(Id.SETV, 200))
    client.say(encode_command(Id.VEL, 500))
    for _ in range(3):
        client.wait(1.0)
        client.say(encode_command(Id.PULSE))
    assert client.motion.speeds(client.now)[0] == pytest.approx(0.2)
    report = decode_standard(client.wait(0.2)[-1].payload)
    assert (report.left_vel, report.right_vel, report.moving) == (200, 200, True)
    assert report.motors_enabled


def test_wheel_speeds_are_taken_apart():
    client = Client()
    client.connect()
    client.say(encode_command(Id.VEL2, vel2_argument(left=-5, right=5)))
    client.wait(1.5)
    speed, turn_rate = client.motion.speeds(client.now)
    assert speed == 0.0
    assert turn_rate == pytest.approx(0.2 * 2.8, rel=0.01)  # 0.1 m/s on half a track of 357 mm


def test_the_watchdog_stops_the_robot_and_any_packet_lets_it_go_on():
    client = Client()
    client.connect()
    client.say(encode_command(Id.VEL, 300))
    client.wait(1.9)
    assert client.motion.speeds(client.now)[0] == pytest.approx(0.3)
    client.wait(2.0)
    assert client.motion.speeds(client.now)[0] == 0.0
    assert client.device.watchdog_trips == 1
    assert client.device.sending  # its servers stay open
    client.say(encode_command(Id.PULSE))
    client.wait(1.5)
    assert client.motion.speeds(client.now)[0] == pytest.approx(0.3)


def test_damaged_packets_are_no_sign_of_life():
    client = Client()
    client.connect()
    for _ in range(5):
        client.say(encode_command(Id.PULSE)[:-1] + b"\x77")
        client.wait(0.5)
    assert client.device.watchdog_trips == 1


def test_close_stops_and_a_reboot_forgets():
    client = Client(PioneerBuild(reboots=((5.0, 1.0),)))
    client.connect()
    client.say(encode_command(Id.VEL, 300))
    client.wait(1.0)
    client.say(encode_command(Id.CLOSE))
    client.wait(2.0)
    assert client.motion.speeds(client.now)[0] == 0.0
    client.connect()
    client.wait(2.5)
    assert client.say(encode_command(0)) == []  # it boots
    client.wait(1.0)
    assert ids(client.say(encode_command(0))) == [0]


def test_config_and_encoders_come_when_asked_for():
    client = Client()
    client.connect()
    config = [p for p in client.say(encode_command(Id.CONFIG)) if p.id == CONFIG]
    assert decode_config(config[0].payload).watchdog == 2000
    client.say(encode_command(Id.ENCODER, 1))
    assert ids(client.wait(1.0)).count(ENCODER) == 1
    client.say(encode_command(Id.ENCODER, 2))
    packets = [p for p in client.wait(1.0) if p.id == ENCODER]
    assert len(packets) == pytest.approx(10, abs=1)
    assert decode_encoders(packets[0].payload).left == 0


def test_the_config_lets_a_client_drive():
    """ARIA takes its limits from there: by zeros it would stand for ever."""
    client = Client()
    client.connect()
    [packet] = [p for p in client.say(encode_command(Id.CONFIG, 1)) if p.id == CONFIG]
    config = decode_config(packet.payload)
    assert (config.rot_vel_top, config.trans_vel_top) == (360, 1000)
    limits = (
        config.rot_acc_top, config.trans_acc_top, config.rot_vel_max, config.trans_vel_max,
        config.rot_acc, config.rot_decel, config.trans_acc, config.trans_decel,
    )  # fmt: skip
    assert min(limits) > 0


def test_inputs_and_outputs_come_when_asked_for():
    client = Client()
    client.connect()
    client.say(encode_command(Id.IOREQUEST, 1))
    assert ids(client.wait(1.0)).count(IO) == 1
    client.say(encode_command(Id.IOREQUEST, 2))
    packets = [p for p in client.wait(1.0) if p.id == IO]
    assert len(packets) == pytest.approx(10, abs=1)
    assert decode_io(packets[0].payload) == IoReport()
    client.say(encode_command(Id.IOREQUEST, 0))
    assert IO not in ids(client.wait(1.0)[1:])


def test_encoders_count_what_each_wheel_rolls():
    client = Client()
    client.connect()
    client.say(encode_command(Id.ENCODER, 2), encode_command(Id.RVEL, 20))
    client.wait(4.0)
    turned = client.motion.odometry(client.now)[2]
    last = [decode_encoders(p.payload) for p in client.wait(0.1) if p.id == ENCODER][-1]
    assert last.left == -last.right
    assert (last.right - last.left) / 128_000 / TRACK_WIDTH_M == pytest.approx(turned, rel=0.03)
    client.say(encode_command(Id.STOP))
    client.wait(2.0)
    begin = [decode_encoders(p.payload) for p in client.wait(0.1) if p.id == ENCODER][-1]
    x, y, _ = client.motion.odometry(client.now)
    client.say(encode_command(Id.VEL, -300))
    client.wait(4.0)
    end = [decode_encoders(p.payload) for p in client.wait(0.1) if p.id == ENCODER][-1]
    x1, y1, _ = client.motion.odometry(client.now)
    assert end.left - begin.left == end.right - begin.right < 0
    assert (begin.left - end.left) / 128_000 == pytest.approx(np.hypot(x1 - x, y1 - y), rel=0.02)


@pytest.mark.parametrize(
    ("commands", "degrees"),
    [
        ([(Id.HEAD, 90)], 90),
        ([(Id.HEAD, 270)], -90),
        ([(Id.DHEAD, -30)], -30),
        ([(Id.DHEAD, 40), (Id.DCHEAD, 40)], 80),
    ],
)
def test_headings_are_turned_to(commands, degrees):
    client = Client()
    client.connect()
    client.say(*(encode_command(*command) for command in commands))
    keep_alive(client, 8.0)
    assert np.degrees(client.motion.odometry(client.now)[2]) == pytest.approx(degrees, abs=1.0)
    assert client.motion.speeds(client.now) == (0.0, 0.0)


@pytest.mark.parametrize("way", [500, -200])
def test_a_distance_is_driven_and_no_more(way):
    client = Client()
    client.connect()
    client.say(encode_command(Id.MOVE, way))
    keep_alive(client, 8.0)
    assert client.motion.odometry(client.now)[0] == pytest.approx(way / 1000, abs=0.01)
    assert client.motion.speeds(client.now) == (0.0, 0.0)


def keep_alive(client, seconds):
    for _ in range(round(seconds)):
        client.say(encode_command(Id.PULSE))
        client.wait(1.0)


def test_no_speed_beyond_the_controllers_own_top():
    """ARIA sends SETV 3000."""
    client = Client()
    client.connect()
    client.say(encode_command(Id.SETV, 3000), encode_command(Id.VEL, 3000))
    keep_alive(client, 5.0)
    assert client.motion.speeds(client.now)[0] == pytest.approx(1.0)


def test_a_battery_can_be_faked():
    client = Client()
    client.connect()
    client.say(encode_command(Id.BATTEST, 101))
    assert decode_standard(client.wait(0.2)[-1].payload).volts == 10.1
    client.say(encode_command(Id.BATTEST, 0))
    assert decode_standard(client.wait(0.2)[-1].payload).volts == 12.8


def test_seto_and_hostbaud_are_obeyed():
    client = Client()
    client.connect()
    client.say(encode_command(Id.VEL, 300))
    client.wait(1.5)
    client.say(bytes.fromhex("fafb04073b073b"))  # as Player sends it
    assert decode_standard(client.wait(0.1)[-1].payload).x < 40
    client.say(encode_command(Id.HOSTBAUD, 2))
    assert client.device.baud == 38400
    client.say(encode_command(Id.CLOSE))
    assert client.device.baud == 9600


def test_unknown_commands_are_ignored():
    client = Client()
    client.connect()
    client.say(encode_packet(b"\xc8\x3b\x01\x00"), encode_packet(b"\x05\x99"))
    assert client.wait(0.5)


@pytest.mark.parametrize("name", ["soar__amrisim.hex.gz", "player_serial__amrisim.hex.gz"])
def test_what_foreign_clients_sent_gets_the_answers_they_waited_for(dialogue, name):
    """Their recorded commands, each followed by a tenth of a second."""
    client, answers, sent = Client(), [], Framer()
    for side, data in dialogue(name):
        if side == ">":
            sent.feed(data, 0)
            answers += client.say(data)
            answers += client.wait(0.1)
    assert ids(answers)[:3] == [0, 1, 2]
    assert len(client.device.commands) == sent.packets
    reports = [decode_standard(p.payload) for p in answers if p.id in STANDARD]
    assert len(reports) > 15
    assert max(r.x for r in reports) > 5  # both drive
    if name.startswith("soar"):
        assert ids(answers).count(CONFIG) == 1
        assert ids(answers).count(ENCODER) == 1
    assert not client.device.connected  # both say goodbye


def test_robots_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="no such robot"):
        PioneerBuild(subclass="b21")


def test_a_stuck_encoder_turns_the_odometry_while_the_robot_goes_straight():
    steps = np.zeros((100, 3))
    steps[:, 0] = 0.01
    truth = track_of((0.0, 0.0, 0.0), steps, 0.02)
    stuck = [OdometryFault("stuck-encoder", 0.5, 1.0)]
    wheels = dead_reckoning(truth, ODOMETRY_NOISE["none"], 0, stuck)
    assert wheels.increments[0].tolist() == [0.01, 0.0, 0.0]
    forward, _, turn = wheels.increments[50].tolist()
    assert forward == pytest.approx(0.005)  # the right wheel alone
    assert turn == pytest.approx(0.01 / TRACK_WIDTH_M)
