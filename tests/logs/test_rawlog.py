"""Rawlogs of MRPT: scans and odometry are found among all that they hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

from tests.logs import rawlogs

START = 1_200_000_000_000_000_000
MOUNT = (0.2, -0.1, 0.3)


def scan_at(k: int, step: float = math.pi / 4) -> LaserScan:
    ranges = np.array([1.0, 2.0, np.inf, 3.0, 4.0], dtype=np.float32)
    return LaserScan(START + k * 10**8, -2.0 * step, step, ranges, range_max=81.0)


def read(tmp_path, things, **wishes):
    log = read_any(rawlogs.write(tmp_path / "a.rawlog", things), Wishes(**wishes))
    mount, *rest = [message for message, _ in log.received()]
    assert isinstance(mount, LaserExtrinsics)
    scans = [m for m in rest if isinstance(m, LaserScan)]
    return log, mount, scans, [m for m in rest if isinstance(m, WheelOdometry)]


@pytest.mark.parametrize("version", [4, 5, 6, 7, 8])
@pytest.mark.parametrize("prefix", ["", "mrpt::obs::"])
@pytest.mark.parametrize("step", [math.pi / 4, -math.pi / 4])
def test_scans_of_all_versions(tmp_path, version, prefix, step):
    label = "LASER" if version >= 5 else ""
    made = [rawlogs.scan(scan_at(k, step), MOUNT, version, label, prefix) for k in range(3)]
    log, mount, scans, _ = read(tmp_path, made)
    assert (mount.x, mount.y, mount.theta) == pytest.approx(MOUNT)
    assert [s.stamp_ns for s in scans] == [START + k * 10**8 for k in range(3)]
    assert scans[0].ranges.tolist() == [1.0, 2.0, math.inf, 3.0, 4.0]
    assert scans[0].angle_min == pytest.approx(-2.0 * step, abs=1e-6)
    assert scans[0].angle_step == pytest.approx(step, abs=1e-6)
    assert log.skipped == {}


def test_a_laser_that_hangs_upside_down_is_turned(tmp_path):
    _, _, scans, _ = read(tmp_path, [rawlogs.scan(scan_at(0), MOUNT, roll=math.pi)])
    assert scans[0].angle_step == pytest.approx(math.pi / 4, abs=1e-6)


@pytest.mark.parametrize("version", [0, 1, 2])
def test_odometry_of_all_versions(tmp_path, version):
    odometry = [WheelOdometry(START + k * 10**8, 0.1 * k, 0.2, -0.3) for k in range(3)]
    made = [rawlogs.wheels(o, version) + rawlogs.scan(scan_at(k), MOUNT)
            for k, o in enumerate(odometry)]  # fmt: skip
    assert read(tmp_path, made)[3] == odometry


def test_steps_of_actions_are_put_together(tmp_path):
    made = []
    for k in range(4):
        frame = (1).to_bytes(4, "little") + rawlogs.scan(scan_at(k), MOUNT)
        made += [rawlogs.moved((0.1, 0.0, math.pi / 2)), rawlogs.thing("CSensoryFrame", 2, frame)]
    log, _, scans, odometry = read(tmp_path, made)
    assert len(scans) == 4
    assert [(round(o.x, 9), round(o.y, 9)) for o in odometry] == [
        (0.1, 0.0), (0.1, 0.1), (0.0, 0.1), (0.0, 0.0),
    ]  # fmt: skip
    assert log.skipped == {}


def test_what_is_damaged_or_unknown_is_counted(tmp_path):
    good = [rawlogs.scan(scan_at(k), MOUNT) for k in range(4)]
    image = rawlogs.thing("CObservationImage", 4, bytes(range(256)) * 20)
    torn = good[1][:60] + good[1][70:]
    later = good[3].replace(b"RangeScan\x07", b"RangeScan\x0b")
    log, _, scans, _ = read(tmp_path, [image, good[0], torn, image, good[2], later])
    assert [s.stamp_ns for s in scans] == [scan_at(k).stamp_ns for k in (0, 2)]
    assert sum(log.skipped.values()) == 2


def test_one_of_several_lasers_is_taken_and_named(tmp_path):
    made = [rawlogs.scan(scan_at(k), MOUNT, label="FRONT" if k % 3 else "REAR") for k in range(6)]
    log, _, scans, _ = read(tmp_path, made)
    assert len(scans) == 4
    assert "--scan takes another (REAR)" in log.warnings[0]
    log, _, scans, _ = read(tmp_path, made, scan="REAR")
    assert (len(scans), log.warnings) == (2, [])
    with pytest.raises(LogError, match="no laser SIDE for --scan"):
        read(tmp_path, made, scan="SIDE")
    with pytest.raises(LogError, match="leave --base out"):
        read(tmp_path, made, base="x")


def test_a_rawlog_that_is_cut_anywhere_gives_what_is_there(tmp_path):
    data = b"".join(rawlogs.scan(scan_at(k), MOUNT) for k in range(3))
    for end in range(1, len(data), 7):
        path = rawlogs.write(tmp_path / "cut.rawlog", [data[:end]], packed=False)
        try:
            log = read_any(path)
        except LogError:
            continue
        assert len(log.messages) - 1 == end // (len(data) // 3)
