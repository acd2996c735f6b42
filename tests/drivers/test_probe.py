import pytest
from slam.drivers.errors import PortError
from slam.drivers.probe import is_sound_state, probe
from slam.drivers.simulators.hokuyo_device import HokuyoBuild
from slam.drivers.simulators.link import WireFaults
from slam.drivers.simulators.pioneer_build import PioneerBuild


def run(bench, **options):
    return probe("/dev/somewhere", clock=bench.time, opener=bench.link, **options)


def test_a_laser_tells_all_about_itself(laser_bench):
    bench = laser_bench(HokuyoBuild(model="utm-30lx", clock_start=5000))
    report = run(bench)
    facts = dict(report.facts)
    assert (report.kind, report.sound, report.advice) == ("laser", True, ())
    assert facts["SERI"] == "H0000001"
    assert facts["field of view"] == "-135.0 to 135.0 deg"
    assert float(facts["rate measured"].split()[0]) == pytest.approx(40.0, abs=0.5)
    assert facts["clock offset"].endswith(" s")
    assert bench.device.state == "idle"


@pytest.mark.parametrize("subclass", ["p3dx-sh", "p3dx"])
def test_a_robot_tells_all_about_itself_and_is_not_moved(robot_bench, subclass):
    bench = robot_bench(PioneerBuild(subclass=subclass))
    report = run(bench)
    facts = dict(report.facts)
    assert (report.kind, report.sound, report.advice) == ("p3dx", True, ())
    assert facts["subclass"] == subclass
    assert facts["watchdog"] == "2000 ms"
    assert facts["battery"] == "12.8 V"
    assert facts["motors"] == "on"
    assert float(facts["rate measured"].split()[0]) == pytest.approx(10.0, abs=0.5)
    assert not bench.device.connected
    assert all(command.id not in (4, 8, 11, 21, 32) for command in bench.device.commands)


def test_a_robot_without_config_is_sound_all_the_same(robot_bench):
    report = run(robot_bench(PioneerBuild(bad_config_sum=True)))
    assert report.sound
    assert "defaults are used" in dict(report.facts)["configuration"]


def test_silence_brings_advice_for_both_kinds(laser_bench):
    report = run(laser_bench(faults=WireFaults(silences=((0.0, 1e9),))))
    assert report.kind is None
    assert not report.sound
    assert any("powered" in line for line in report.advice)
    assert any("HOST port" in line for line in report.advice)


def test_a_port_that_does_not_open_brings_its_advice():
    def refuse(name, baud):
        raise PortError("do this")

    report = probe("/dev/x", opener=refuse)
    assert (report.kind, report.advice) == (None, ("do this",))


def test_trouble_is_named(laser_bench):
    slow = laser_bench(HokuyoBuild(model="urg-04lx"), serial=True)
    assert any("scans a second" in line for line in run(slow, kinds=("laser",)).advice)


def test_a_faulty_laser_is_named_and_nothing_else_is_asked(laser_bench):
    bench = laser_bench(HokuyoBuild(fault_at_s=0.0))
    report = run(bench)
    assert (report.kind, report.sound) == ("laser", False)
    assert report.title == "SOKUIKI Sensor TOP-URG UTM-30LX"
    assert any("hardware fault 50" in line for line in report.advice)
    assert any("Laser malfunction" in line for line in report.advice)
    assert b"\xfa\xfb" not in bench.sent()
    assert bench.time.now_s < 5.0


@pytest.mark.parametrize(
    ("words", "sound"),
    [
        ("Sensor works well.", True),
        ("Stable 000 no error.", True),
        ("sensor is working normally", True),
        ("Unstable 100 laser.", False),
        ("sensor state is abnormal", False),
        ("Sensor does not work well", False),
        ("Sensor works well. Not.", False),
    ],
)
def test_a_sensors_words_are_taken_whole(words, sound):
    assert is_sound_state(words) == sound


def test_a_slow_line_has_a_rate_all_the_same(laser_bench):
    bench = laser_bench(HokuyoBuild(model="urg-04lx"), serial=True)
    assert dict(run(bench).facts)["rate measured"] != "0.0 Hz"
