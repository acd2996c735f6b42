"""Logs as other people's robots leave them: what replay makes of them, and what the doctor says."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.worlds import scenario
from slam.logs.doctor import diagnose
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry
from slam.logs.trajectory import read_tum

from slam.runs.config_file import load_config
from slam.runs.replay import replay
from tests.slam.conftest import START_NS

SCANS = 40
MINUTES_NS = 300 * 10**9


@pytest.fixture(scope="module")
def drive(sense):
    poses = [Pose2(0.05 * k, 0.0, 0.0) for k in range(SCANS)]
    return sense(scenario("testbed").world, poses)


@pytest.fixture
def played(tmp_path):
    """Writes, replays and examines messages."""

    def play(messages):
        log = tmp_path / "odd.mcap"
        with LogWriter(log) as writer:
            for message in messages:
                writer.write(message)
        summary = replay(log, tmp_path / "run", load_config(None))
        codes = {finding.code: finding.severity for finding in diagnose(log).findings}
        return summary, read_tum(tmp_path / "run" / "trajectory.tum"), codes

    return play


def shifted(messages, by_ns, first=0):
    return [replace(m, stamp_ns=m.stamp_ns + by_ns * (k >= first)) for k, m in enumerate(messages)]


def test_stamps_from_1970_give_the_same_path(drive, played):
    summary, track, codes = played(shifted(drive, 5 * 10**9 - START_NS))
    assert summary["lost"] == {}
    assert codes == {"clock-unset": "note"}
    assert track.stamps_ns[0] == 5 * 10**9
    assert len(track) == SCANS
    assert track.poses[-1][0] == pytest.approx(0.05 * (SCANS - 1), abs=0.02)


def test_a_clock_that_is_set_during_the_drive(drive, played):
    early = [replace(m, stamp_ns=m.stamp_ns - START_NS) for m in drive[:61]]
    summary, track, codes = played([*early, *drive[61:]])
    assert len(track) == summary["scans"] >= SCANS - 1
    assert codes["clock-set-late"] == "error"
    assert track.poses[-1][0] == pytest.approx(0.05 * (SCANS - 1), abs=0.05)


def test_a_gap_of_minutes(drive, played):
    summary, track, codes = played(shifted(drive, MINUTES_NS, first=61))
    assert len(track) == SCANS - summary["lost"].get("scan without odometry in time", 0)
    assert summary["duration_s"] > 300
    assert codes == {"scan-gap": "warning", "odom-gap": "warning"}
    assert track.poses[-1][0] == pytest.approx(0.05 * (SCANS - 1), abs=0.05)


def test_duplicate_stamps(drive, played):
    double = [m for one in drive for m in ([one, one] if isinstance(one, LaserScan) else [one])]
    summary, track, codes = played(double)
    assert summary["lost"] == {"scan with a stamp that runs backwards": SCANS}
    assert len(track) == SCANS
    assert codes["stamps-duplicate"] == "warning"


def test_two_lasers_on_one_channel(drive, played):
    mixed, k = [], 0
    for message in drive:
        if isinstance(message, LaserScan):
            k += 1
            if k % 2:  # every other scan from a laser with half the beams
                half = np.ascontiguousarray(message.ranges[::2])
                message = replace(message, ranges=half, angle_step=2 * message.angle_step)
        mixed.append(message)
    _, track, codes = played(mixed)
    assert len(track) == SCANS
    assert codes["two-lasers"] == "error"
    assert track.poses[-1][0] == pytest.approx(0.05 * (SCANS - 1), abs=0.05)


def test_two_mounts(drive, played):
    mounts = [
        LaserExtrinsics(m.stamp_ns, 0.3, 0.0, 0.0) for m in drive if isinstance(m, WheelOdometry)
    ]
    _, track, codes = played([*drive[:50], mounts[20], *drive[50:]])
    assert len(track) == SCANS
    assert codes["mount-changes"] == "error"


@pytest.mark.parametrize("step", [1e-300, -1e-12, 0.0])
def test_a_scan_whose_beams_lie_on_each_other_is_left_out(drive, played, step):
    odd = [replace(m, angle_step=step) if k in (30, 33, 36) and isinstance(m, LaserScan) else m
           for k, m in enumerate(drive)]  # fmt: skip
    summary, track, _ = played(odd)
    lost = SCANS - len(track)
    assert 0 < lost <= 3
    assert summary["lost"] == {"scan whose beams have no possible direction": lost}
