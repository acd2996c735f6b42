import numpy as np
import pytest
from slam.drivers.scip_protocol import ReplyFramer, decode_information, is_sound, with_sum
from slam.drivers.scip_scan import ScanRequest, decode_scan
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line
from slam.drivers.simulators.motion import TrackMotion
from slam.drivers.simulators.robot import track_of
from slam.drivers.simulators.sweep import Sweeper, clustered
from slam.drivers.simulators.world import World

ROOM = World.from_polygon([(-3, -2), (6, -2), (6, 2), (-3, 3)])


def still():
    track = track_of((0.0, 0.0, 0.0), np.zeros((1, 3)), 1.0)
    return TrackMotion(track, track)


class Client:
    """Talks to a sensor line by line, without any of the drivers' sessions."""

    def __init__(self, **build):
        self.build = HokuyoBuild(**build)
        sweeper = Sweeper(MODELS[self.build.model], ROOM, still())
        self.device, self.framer, self.now = HokuyoDevice(sweeper, self.build), ReplyFramer(), 0.0

    def say(self, *lines):
        for line in lines:
            self.device.receive(line.encode() + b"\n", self.now)
        return self.wait(0.0)

    def wait(self, seconds):
        self.now += seconds
        return self.framer.feed(self.device.advance(self.now), round(self.now * 1e9))

    def status(self, line):
        [reply] = self.say(line)
        assert reply.echo == line.encode()
        return reply.status


def test_a_laser_that_is_off_does_not_measure():
    client = Client()
    client.wait(1.0)
    assert client.status("GD0000108001") == "10"
    assert client.status("BM") == "00"
    assert client.status("BM") == "02"
    [reply] = client.say("GD0000108001")
    assert (reply.status, decode_scan(reply).distances.shape) == ("00", (1081,))
    assert client.status("QT") == "00"
    assert client.status("GD0000108001") == "10"


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("MD0000110001000", "04"),
        ("MD0900018001000", "05"),
        ("MD00001080", "0C"),
        ("MD00001080010000", "0D"),
        ("GD000010800100", "0D"),
        ("RT", "0E"),
        ("%ST", "0E"),
        ("TM1", "04"),
        ("TM2", "03"),
        ("TM9", "01"),
        ("SS019200", "03"),
        ("SS1", "02"),
        ("CR01", "04"),
        ("HS1", "03"),
        ("SCIP2.0", "0E"),
    ],
)
def test_what_cannot_be_done_has_its_code(line, status):
    assert Client().status(line) == status


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("MDx000108001000", "01"),
        ("GD0000x08001", "02"),
        ("MD00001080+1000", "03"),
        ("ME000010800.000", "03"),
        ("MD000010800100x", "07"),
        ("MD0000108001x00", "06"),
        ("MD0000108001000;seventeen letters", "0G"),
        ("VV;what?", "0H"),
    ],
)
def test_what_cannot_be_read_is_told_by_its_first_wrong_part(line, status):
    device = Client().device
    device.receive(line.encode() + b"\n", 0.0)
    assert device.advance(0.0) == line.encode() + b"\n" + with_sum(status.encode()) + b"\n\n"


def test_what_is_no_command_is_told_as_such():
    client = Client()
    client.device.receive(b"XX\nhello\n", 0.0)
    assert client.device.advance(0.0) == b"XX\n0Ee\n\nhello\n0Ee\n\n"


def test_an_urg_answers_for_all_its_steps_and_measures_some_of_them():
    client = Client(model="urg-04lx")
    client.say("SCIP2.0")
    client.say("BM")
    client.wait(1.0)
    assert client.status("MD0000076901000") == "04"
    [reply] = client.say("GD0000076801")
    distances = decode_scan(reply).distances
    assert distances.shape == (769,)
    assert set(distances[:44].tolist()) | set(distances[726:].tolist()) == {19}
    assert np.count_nonzero(distances[44:726] > 19) > 500


def test_an_urg_says_who_it_is_before_it_is_told_to_speak_scip_2():
    client = Client(model="urg-04lx")
    client.device.receive(b"V\n", 0.0)
    answer = client.device.advance(0.0).decode()
    assert answer.startswith("V\n0\nVEND:Hokuyo")
    assert answer.split("\n")[6:] == ["SERI:H0000001", "", ""]
    client.device.receive(b"L1\n", 0.0)
    assert client.device.advance(0.0) == b"L1\nE\n\n"


def test_md_says_yes_first_and_then_counts_down():
    client = Client()
    [yes] = client.say("MD0180090004003")
    assert (yes.echo, yes.status, yes.lines) == (b"MD0180090004003", "00", ())
    reports = client.wait(1.0)
    assert [r.echo[-2:] for r in reports] == [b"02", b"01", b"00"]
    assert {r.status for r in reports} == {"99"}
    assert {decode_scan(r).distances.size for r in reports} == {181}
    assert client.device.state == "idle"  # the last one switches the laser off
    assert client.wait(1.0) == []


def test_a_single_scan_can_be_had_while_others_stream():
    client = Client()
    client.say("MD0000108001000")
    client.wait(1.0)
    [reply] = client.say("GD0180090004")
    assert (reply.status, decode_scan(reply).distances.size) == ("00", 181)
    assert client.wait(0.1)[0].echo == b"MD0000108001000"


def test_without_end_the_echo_stays_at_zero_until_quit():
    client = Client()
    client.say("MD0000108001000;me")
    reports = client.wait(1.0)
    assert len(reports) == pytest.approx(40, abs=1)
    assert {r.echo for r in reports} == {b"MD0000108001000;me"}
    assert client.status("QT") == "00"
    assert client.wait(1.0) == []


def test_skipped_scans_show_in_the_timestamps():
    client = Client()
    client.say("MD0000108001200")  # every third: 75 ms, as a real one was seen to do
    stamps = [decode_scan(r).timestamp for r in client.wait(1.0)]
    assert set(np.diff(stamps)) == {75}


def test_the_clock_can_be_read_in_its_own_mode_only():
    client = Client(clock_start=1000)
    assert client.status("TM0") == "00"
    assert client.status("TM0") == "02"
    assert client.status("PP") == "0E"
    assert client.status("MD0000108001000") == "0E"
    client.wait(0.5)
    [reply] = client.say("TM1")
    assert is_sound(reply.lines[0])
    assert client.status("TM2") == "00"
    client.say("MD0000108001000")
    assert client.status("TM0") == "10"


def test_reset_sets_the_counter_to_zero_and_a_reboot_must_be_asked_for_twice():
    client = Client(clock_start=1_000_000)
    client.wait(1.0)
    client.say("RS")
    assert client.device.count(client.now) == 0
    assert [client.status("RB"), client.status("RB")] == ["01", "00"]
    client.wait(0.1)
    assert client.say("QT") == []
    client.wait(2.0)
    assert client.status("QT") == "00"


def test_the_counter_wraps_and_drifts():
    device = Client(clock_start=(1 << 24) - 10, clock_rate=1.001).device
    assert device.count(0.02) == 10
    assert device.count(1000.0) == 1_001_000 - 10


@pytest.mark.parametrize("model", MODELS)
def test_every_line_of_every_answer_has_a_sound_sum(model):
    client = Client(model=model)
    client.say("SCIP2.0")
    for reply in client.say("VV", "PP", "II"):
        assert decode_information(reply.lines)[1] == 0
    client.say("BM")
    last = MODELS[model].parameters.last_step
    client.wait(1.0)
    [reply] = client.say(f"GD{MODELS[model].parameters.first_step:04}{last:04}01")
    assert all(map(is_sound, reply.lines))


def test_an_old_urg_speaks_scip_1_1_until_told():
    client = Client(model="urg-04lx")
    assert client.status("VV") == "E"
    assert client.status("SCIP2.0") == "00"
    assert client.status("VV") == "00"


def test_a_broken_laser_reports_it():
    client = Client(fault_at_s=0.5)
    client.say("MD0000108001000")
    assert client.wait(1.0)[-1].status == "50"
    [state] = client.say("II")
    assert "malfunction" in decode_information(state.lines)[0]["STAT"]


def test_a_cluster_is_its_smallest_range_and_codes_count_only_alone():
    distances = np.array([500, 400, 1, 450, 1, 1, 1, 1, 300], np.int32)
    assert clustered(distances, 4).tolist() == [400, 1, 300]
    assert clustered(distances, 1) is distances


def test_a_bent_sweep_differs_from_a_frozen_one_on_the_move():
    steps = np.tile([0.02, 0.0, 0.02], (100, 1))
    moving = TrackMotion(*[track_of((0.0, 0.0, 0.0), steps, 0.02)] * 2)
    request = ScanRequest("MD", 0, 1080)
    model = MODELS["utm-30lx"]
    frozen, bent = (
        Sweeper(model, ROOM, moving, sigma_m=0.0, bends=bends).distances(request, 0.5)
        for bends in (False, True)
    )
    assert frozen[0] == bent[0]
    assert abs(int(frozen[-1]) - int(bent[-1])) > 3


def test_equal_sweeps_give_equal_numbers():
    request = ScanRequest("MD", 0, 1080)
    one, other = (Sweeper(MODELS["utm-30lx"], ROOM, still(), seed=4) for _ in range(2))
    one.distances(request, 0.025)
    np.testing.assert_array_equal(one.distances(request, 0.5), other.distances(request, 0.5))


def test_what_urg_library_sent_gets_the_answers_it_waited_for(dialogue):
    """Its recorded commands; the right echoes in the right order, all sums sound."""
    client, expected, got = Client(model="utm-30lx-ew"), ReplyFramer(), []
    wanted = []
    for side, data in dialogue("urgcheck_serial__urgsim.hex.gz"):
        if side == ">":
            client.device.receive(data, client.now)
            got += client.wait(0.0)
        else:
            wanted += expected.feed(data, 0)
            got += client.wait(0.026 * data.count(b"\n99b\n"))
    got += client.wait(0.1)
    answers = [(r.echo, r.status) for r in got if r.status != "99"]
    assert answers == [(r.echo, r.status) for r in wanted if r.status != "99"]
    sizes = {r.echo[:12]: decode_scan(r).distances.size for r in got if r.status == "99"}
    theirs = {r.echo[:12]: decode_scan(r).distances.size for r in wanted if r.status == "99"}
    assert sizes == theirs


@pytest.mark.parametrize("name", ["utm_30lx", "urg_04lx"])
def test_what_hokuyoaist_sent_gets_the_lines_the_real_sensor_gave(capture, name):
    client = Client(model=name.replace("_", "-"))
    client.say("SCIP2.0")
    client.say("BM")
    client.wait(1.0)
    got = []
    for line in capture(f"example_{name}.logw.raw").split():
        got += client.say(line.decode())
        got += client.wait(0.1)
    real = ReplyFramer().feed(capture(f"example_{name}.logr.raw"), 0)
    assert [r.symbol for r in got] == [r.symbol for r in real]
    for ours, theirs in zip(got, real, strict=True):
        if ours.symbol == "PP":
            assert ours.lines == theirs.lines
        elif ours.symbol == "VV":
            assert (
                decode_information(ours.lines)[0].keys()
                == decode_information(theirs.lines)[0].keys()
            )


def test_a_new_speed_counts_behind_the_answer():
    """urg_library sets its own speed when it has the answer, and waits 150 ms."""
    client, slow = Client(model="urg-04lx"), 19200
    line, now = Line(client.device), 0.0
    line.to_device(b"SCIP2.0\n", now, slow)
    line.to_host(0.5, slow)
    line.to_device(b"SS115200\n", 0.5, slow)
    assert line.to_host(0.6, slow) == b"SS115200\n00P\n\n"
    line.to_device(b"QT\n", 0.7, 115200)
    assert line.to_host(0.8, 115200) == b"QT\n00P\n\n"
    line.to_device(b"RS\n", 0.8, 115200)
    assert line.to_host(0.9, 115200) == b"RS\n00P\n\n"
    assert client.device.baud == slow


def test_sensors_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="no such sensor"):
        HokuyoBuild(model="lms200")
    with pytest.raises(ValueError, match="different models"):
        HokuyoDevice(Sweeper(MODELS["urg-04lx"], ROOM, still()), HokuyoBuild())
