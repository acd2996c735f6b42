from __future__ import annotations

from pathlib import Path

import pytest
from slam.logs.errors import LogError
from slam.logs.importers.breezyslam import FIELDS, read_breezyslam
from slam.logs.importers.detect import read_any
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserScan, WheelOdometry


def rover_line(time_us: int, left: int, right: int) -> str:
    ranges = [0, 5, -1, 1500] + [1000] * (FIELDS - 24 - 4)
    return " ".join(map(str, [time_us, 0, left, right, *[0] * 20, *ranges])) + "\n"


def test_kinds_are_told_apart_by_content(tmp_path: Path):
    path = tmp_path / "anything.bin"
    path.write_text("# comment\nFLASER 2 1 1 0 0 0 0 0 0 1.5 h 0\n")
    assert read_any(path).kind == "CARMEN"
    path.write_text(rover_line(1, 0, 0))
    assert read_any(path).kind == "BreezySLAM"


def test_what_is_no_log_is_one_clear_line(tmp_path: Path):
    path = tmp_path / "x.clf"
    path.write_bytes(b"\x89PNG\r\n")
    with pytest.raises(LogError, match=r"CARMEN .* can be imported"):
        read_any(path)
    with LogWriter(tmp_path / "a.mcap"):
        pass
    with pytest.raises(LogError, match="slam replay"):
        read_any(tmp_path / "a.mcap")


def test_a_rover_that_turns_its_wheels_once_goes_one_circumference(tmp_path: Path):
    path = tmp_path / "x.dat"
    lines = [rover_line(1000, 10, 20), "1 2 3\n", rover_line(2000, 2010, 2020)]
    path.write_text("".join([*lines, rover_line(3000, 2010, 2520)]))
    log = read_breezyslam(path)
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    assert [m.stamp_ns for m in odometry] == [1_000_000, 2_000_000, 3_000_000]
    assert odometry[1].x == pytest.approx(6.2831853 * 0.077)
    assert odometry[2].theta == pytest.approx(6.2831853 * 0.077 / 4 / 0.33)
    assert log.skipped == {"wrong number of fields": 1}


def test_codes_of_the_hokuyo(tmp_path: Path):
    path = tmp_path / "x.dat"
    path.write_text(rover_line(1, 0, 0).replace(" 1000 1000 1000 ", " 0 19 1000 "))
    scan = next(m for m in read_breezyslam(path).messages if isinstance(m, LaserScan))
    values = {str(v) for v in scan.ranges[70:-70].tolist()}
    assert values == {"inf", "nan", "1.0"}
