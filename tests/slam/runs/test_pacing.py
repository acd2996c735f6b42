"""Replay at the pace of the drive: when messages come, and that they stay the same."""

import hashlib
import math
import time

import pytest
from gtsam import Pose2
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import WheelOdometry

from slam.runs.config_file import load_config
from slam.runs.pacing import LONGEST_S, paced
from slam.runs.replay import replay


class Time:
    """A clock that only waiting moves."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        assert seconds > 0
        self.now_s += seconds


def arrivals(stamps_s, rate=1.0, busy_s=0.0):
    """When each message comes, for a receiver that takes `busy_s` for each."""
    clock, came = Time(), []
    messages = [WheelOdometry(round(s * 1e9), 0.0, 0.0, 0.0) for s in stamps_s]
    for message in paced(iter(messages), rate, clock, clock.sleep):
        assert message is messages[len(came)]
        came.append(clock.now_s - 100.0)
        clock.now_s += busy_s
    assert len(came) == len(messages)
    return came


@pytest.mark.parametrize("rate", [0.5, 1.0, 40.0])
def test_messages_come_when_they_are_due(rate):
    stamps = [1.7e9, 1.7e9 + 0.1, 1.7e9 + 0.25, 1.7e9 + 2.0]
    due = [(s - stamps[0]) / rate for s in stamps]
    assert arrivals(stamps, rate) == pytest.approx(due, abs=1e-6)


def test_a_late_receiver_catches_up():
    assert arrivals([0, 1, 1.1, 1.2, 4], busy_s=0.5) == pytest.approx([0, 1, 1.5, 2.0, 4])


def test_stamps_a_little_out_of_order_take_no_time():
    assert arrivals([10, 12, 11, 13]) == pytest.approx([0, 2, 2, 3])


def test_a_clock_that_was_set_does_not_stop_the_replay():
    year_s = 3e7
    came = arrivals([0, 1, 50 * year_s, 50 * year_s + 1, 2, 3])
    assert came == pytest.approx([0, 1, 1 + LONGEST_S, 2 + LONGEST_S, 2 + LONGEST_S, 3 + LONGEST_S])


@pytest.mark.parametrize("rate", [math.inf, math.nan])
def test_no_rate_at_all_waits_for_nothing(rate):
    assert arrivals([0, 1, 2], rate) == [0, 0, 0]


def test_a_paced_replay_is_the_same_run(tmp_path, sense):
    poses = [Pose2(0.05 * k, 0.0, 0.0) for k in range(60)]
    with LogWriter(tmp_path / "log.mcap") as log:
        for message in sense(scenario("testbed").world, poses):
            log.write(message)
    took_s = {}
    for name, rate in (("fast", 0.0), ("paced", 3.0)):
        began = time.monotonic()
        replay(tmp_path / "log.mcap", tmp_path / name, load_config(None), rate=rate)
        took_s[name] = time.monotonic() - began
    assert took_s["paced"] > 5.9 / 3.0  # 60 scans at 10 Hz
    for file in ("trajectory.tum", "graph.g2o", "map.pgm", "graph.times.csv"):
        first, second = (
            hashlib.sha256((tmp_path / run / file).read_bytes()).hexdigest() for run in took_s
        )
        assert first == second, file
