import pytest
from slam.drivers.arcos_protocol import Framer, Id, decode_command, encode_command
from slam.drivers.errors import LinkLost, NoReply, PortError, Refused, WrongDevice
from slam.drivers.motion import MotionConfig
from slam.drivers.pioneer import PASSIVE, PioneerConfig
from slam.drivers.pioneer_decoder import MODELS
from slam.drivers.simulators.link import WireFaults
from slam.drivers.simulators.motion import CommandedMotion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.logs.messages import RawBytes, WheelOdometry


def sent_ids(bench):
    return [decode_command(p.payload).id for p in Framer().feed(bench.sent(), 0)]


def test_a_robot_is_brought_to_reporting_its_drive(robot_bench):
    bench = robot_bench()
    assert "p3dx-sh" in bench.session.connect()
    bench.run(10.0)
    # The very first report waits on the line until the CONFIGpac, 120 ms long, is through.
    _, first, *_, last = bench.messages(WheelOdometry)
    drove = 0.3 * (last.stamp_ns - first.stamp_ns) * 1e-9
    assert last.x - first.x == pytest.approx(drove, abs=0.01)
    assert bench.session.decoder.counters()["reports"] == pytest.approx(100, abs=3)
    assert bench.device.watchdog_trips == 0
    bench.session.close()
    assert not bench.device.connected


def test_nothing_that_moves_the_robot_is_ever_sent(robot_bench):
    bench = robot_bench()
    bench.session.connect()
    bench.run(5.0)
    with pytest.raises(Refused, match="motion is off"):
        bench.session.drive(0.1, 0.0)
    bench.session.close()
    assert set(sent_ids(bench)) <= set(PASSIVE)
    assert Id.ENABLE not in PASSIVE
    assert (Id.SONAR, 0) in bench.device.commands


def test_signs_of_life_keep_within_the_watchdog(robot_bench):
    bench = robot_bench()
    bench.session.connect()
    before = len(sent_ids(bench))
    bench.run(10.0)
    assert 18 <= sent_ids(bench)[before:].count(Id.PULSE) <= 21


@pytest.mark.parametrize("left_at", ["SYNC0", "SYNC1", "SYNC2", "OPEN"])
def test_a_robot_is_taken_over_from_any_state(robot_bench, left_at):
    bench = robot_bench()
    for name, number in (("SYNC0", 0), ("SYNC1", 1), ("SYNC2", 2), ("OPEN", 1)):
        bench.line.to_device(encode_command(number), bench.time.now_s, 9600)
        if name == left_at:
            break
    bench.time.sleep(3.0)
    bench.session.connect()
    assert bench.device.sending
    assert bench.session.decoder.identity.subclass == "p3dx-sh"


@pytest.mark.parametrize(("baud", "most_s"), [(38400, 3.0), (115200, 6.0)])
def test_a_robot_left_at_another_speed_is_closed_there_at_once(robot_bench, baud, most_s):
    bench = robot_bench()
    for number in (0, 1, 2, 1):
        bench.line.to_device(encode_command(number), bench.time.now_s, 9600)
    code = {38400: 2, 115200: 4}[baud]
    bench.line.to_device(encode_command(Id.HOSTBAUD, code), bench.time.now_s, 9600)
    bench.time.sleep(1.0)
    assert bench.device.baud == baud
    began = bench.time.now_s
    bench.session.connect()
    assert bench.time.now_s - began < most_s
    assert bench.device.sending


@pytest.mark.parametrize("subclass", ["p3dx-sh-lms1xx", "p3dx-sh-lms500"])
def test_robots_delivered_with_another_laser_are_known(robot_bench, subclass):
    bench = robot_bench(PioneerBuild(subclass=subclass))
    assert subclass in bench.session.connect()
    assert bench.session.decoder.model == MODELS["p3dx-sh"]


def test_syncs_are_never_repeated_before_their_time(robot_bench):
    """The second SYNC2 would be a CLOSE; a slow answer must be waited for."""
    bench = robot_bench(faults=WireFaults(delay_s=0.4))
    bench.session.connect()
    syncs = [p for p in bench.messages(RawBytes) if p.direction == "tx" and len(p.data) == 6]
    assert [p.data[3] for p in syncs[:3]] == [0, 1, 2]
    bench.run(2.0)
    assert bench.device.sending


def test_a_lost_answer_to_sync2_does_not_close_what_it_opened(robot_bench):
    bench = robot_bench(faults=WireFaults(silences=((0.06, 0.3),)))
    bench.session.connect()
    bench.run(1.0)
    assert bench.device.sending


@pytest.mark.parametrize("baud", [19200, 38400, 115200])
def test_the_right_speed_is_found(robot_bench, baud):
    bench = robot_bench(PioneerBuild(baud=baud, auto_baud=False))
    assert f"{baud} baud" in bench.session.connect()


def test_hostbaud_is_used_where_the_robot_says_it_can(robot_bench):
    assert "38400 baud" in robot_bench().session.connect()
    assert "9600 baud" in robot_bench(PioneerBuild(auto_baud=False)).session.connect()
    assert "9600 baud" in robot_bench(fast_baud=None).session.connect()


@pytest.mark.parametrize(
    "build",
    [
        PioneerBuild(bad_config_sum=True),
        PioneerBuild(answers_config=False),
        PioneerBuild(tail_bytes=0),
        PioneerBuild(tail_bytes=5),
        PioneerBuild(tells_moving=False),
        PioneerBuild(counts_16_bits=True),
        PioneerBuild(subclass="p3dx"),
    ],
)
def test_habits_of_real_and_simulated_robots_are_put_up_with(robot_bench, build):
    bench = robot_bench(build)
    bench.session.connect()
    bench.run(3.0)
    odometry = bench.messages(WheelOdometry)
    speed = (odometry[-1].x - odometry[0].x) / (odometry[-1].stamp_ns - odometry[0].stamp_ns) * 1e9
    assert speed == pytest.approx(0.3, rel=0.02)


def test_9600_baud_carries_reports_without_sonar_but_not_with_it(robot_bench):
    rates = {}
    for sonar in (False, True):
        bench = robot_bench(PioneerBuild(auto_baud=False, cycle_s=0.05), sonar=sonar)
        bench.session.connect()
        before = len(bench.messages(WheelOdometry))
        bench.run(20.0)
        rates[sonar] = (len(bench.messages(WheelOdometry)) - before) / 20.0
    assert rates[False] == pytest.approx(20.0, rel=0.05)
    assert rates[True] < 12.0  # 89 bytes take 93 ms


def test_no_robot_is_told_as_such(robot_bench):
    bench = robot_bench(faults=WireFaults(silences=((0.0, 1e9),)), attempts=3)
    with pytest.raises(NoReply, match="switched on"):
        bench.session.connect()
    assert bench.time.now_s < 10.0


def test_a_robot_of_unknown_factors_is_refused(robot_bench, monkeypatch):
    bench = robot_bench()
    monkeypatch.setattr("slam.drivers.pioneer_decoder.MODELS", {"p3dx": MODELS["p3dx"]})
    with pytest.raises(WrongDevice, match="p3dx-sh"):
        bench.session.connect()
    again = robot_bench(model=MODELS["p3dx-sh"])
    again.session.connect()


def test_silence_is_noticed_within_its_time(robot_bench):
    bench = robot_bench(faults=WireFaults(silences=((5.0, 100.0),)))
    bench.session.connect()
    with pytest.raises(NoReply, match="no report"):
        bench.run(60.0)
    assert bench.time.now_s < 6.5


def test_a_robot_that_restarts_is_noticed_at_its_first_echo(robot_bench):
    bench = robot_bench(PioneerBuild(reboots=((5.0, 0.2),)))
    bench.session.connect()
    with pytest.raises((LinkLost, NoReply)):
        bench.run(60.0)
    assert bench.time.now_s < 6.5
    bench.session.drop()
    bench.session.connect()
    bench.run(2.0)
    assert bench.session.decoder.restarts == 1


def test_an_unplugged_robot_is_taken_up_where_it_is(robot_bench):
    bench = robot_bench(faults=WireFaults(unplugged=((5.0, 6.0),)))
    bench.session.connect()
    with pytest.raises(LinkLost):
        bench.run(60.0)
    bench.session.drop()
    with pytest.raises(PortError):
        bench.session.connect()
    bench.time.sleep(1.0)
    assert bench.session.connect().startswith("resumed")
    bench.run(2.0)
    _, first, *_, last = bench.messages(WheelOdometry)
    elapsed = (last.stamp_ns - first.stamp_ns) * 1e-9
    assert last.x - first.x == pytest.approx(0.3 * elapsed, abs=0.01)  # the gap included


def test_with_consent_the_robot_moves_and_stops_when_nobody_asks(robot_bench):
    bench = robot_bench(motion=CommandedMotion())
    bench.session.close()
    consent = MotionConfig(speed_max=0.2)
    bench = robot_bench(motion=CommandedMotion())
    bench.session = type(bench.session)(
        PioneerConfig(port="memory", motion=consent), bench.received.append, bench.time, bench.link
    )
    bench.session.connect()
    for _ in range(40):
        bench.session.drive(5.0, 0.0)
        bench.run(0.1)
    assert bench.device._motion.speeds(bench.time.now_s)[0] == pytest.approx(0.2)
    bench.run(2.0)
    assert bench.device._motion.speeds(bench.time.now_s) == (0.0, 0.0)
    bench.session.close()
    assert bench.device.commands[-3:] == [(Id.STOP, None), (Id.ENABLE, 0), (Id.CLOSE, None)]


@pytest.mark.parametrize(
    "wrong", [{"baud": 4800}, {"fast_baud": 1}, {"pulse_s": 3.0}, {"reply_s": 0.2}]
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ValueError, match=r"baud|need"):
        PioneerConfig(port="x", **wrong)


def test_a_session_that_is_not_connected_says_so(robot_bench):
    with pytest.raises(LinkLost, match="not connected"):
        robot_bench().session.poll()
