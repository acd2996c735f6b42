import math
from types import SimpleNamespace

import pytest
from slam.drivers.arcos_reports import MOTORS_ENABLED, STOP_BUTTON, StandardReport

from slam.online.device_notes import RobotWatch
from slam.runs.status import Status


def lines(watch, **fields):
    decoder = SimpleNamespace(latest=StandardReport(**({"battery": 128} | fields)))
    return [(line.level, line.text) for line in watch.look(decoder, 1)]


def test_the_robots_condition_is_told_when_it_changes():
    watch = RobotWatch()
    assert watch.look(SimpleNamespace(latest=None), 0) == []
    assert lines(watch, flags=MOTORS_ENABLED) == []
    assert lines(watch, flags=MOTORS_ENABLED, battery=127) == []
    assert lines(watch) == [("warning", "motors off")]
    assert lines(watch) == []
    assert lines(watch, flags=MOTORS_ENABLED) == [("info", "motors on")]
    (stop,) = lines(watch, flags=MOTORS_ENABLED | STOP_BUTTON)
    assert stop == ("warning", "the STOP button is pressed: release it, then press MOTORS")
    assert watch.warnings == (stop[1],)
    assert lines(watch, flags=MOTORS_ENABLED) == [("info", "STOP button released")]
    low = lines(watch, flags=MOTORS_ENABLED, battery=110)
    assert low == [("warning", "charge the batteries: 11.0 V")]
    assert lines(watch, flags=MOTORS_ENABLED, battery=109) == []


def test_what_is_odd_from_the_start_is_told_at_once():
    assert lines(RobotWatch()) == [("warning", "motors off")]
    assert lines(RobotWatch(), flags=MOTORS_ENABLED, stall_bumpers=1) == [
        ("warning", "a wheel is stalled")
    ]


def status(links, age_s=0.02, **more):
    return Status(9.0, links, 0.0, age_s, 0, 3, math.nan, (), {}, **more)


GOOD = {"laser": "connected", "p3dx": "resumed"}


@pytest.mark.parametrize(
    ("links", "age_s", "reasons", "alarm"),
    [
        (GOOD, 0.02, {}, ""),
        (GOOD, 3.21, {"laser": "it checks itself"}, "no scan for 3.2 s; laser: it checks itself"),
        (GOOD | {"laser": "lost"}, 0.5, {"laser": "no scan"}, "laser lost: no scan"),
        ({"laser": "failed", "p3dx": "waiting"}, 9.0, {}, "laser failed; p3dx waiting"),
        ({"laser": "closed", "p3dx": "closed"}, 9.0, {}, ""),
    ],
)
def test_an_alarm_says_why_nothing_is_live(links, age_s, reasons, alarm):
    assert status(links, age_s, reasons=reasons).alarm == alarm


def test_the_line_says_the_true_age():
    assert "age 20 ms" in status(GOOD).line()
    assert "age 6.0 s" in status(GOOD, 6.0).line()
    assert "motors off" in status(GOOD, robot={"motors": "off"}).line()
