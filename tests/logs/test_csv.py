from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.exporters.csv import write_csv
from slam.logs.messages import (
    LaserScan,
    LoopResult,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    WheelOdometry,
)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_one_table_a_topic_and_numbers_that_read_back(tmp_path: Path):
    ranges = np.array([1.1, np.inf, np.nan], dtype=np.float32)
    messages = [
        (7, WheelOdometry(5, 0.1, 1 / 3, -2.0)),
        (None, LaserScan(6, -1.5, 0.1, ranges)),
        (None, PoseEstimate(6, 0.0, 0.0, 0.0, (0.1,) * 9)),
        (None, RawBytes(6, "laser", "rx", b"\x00\xff")),
        (None, LoopResult(6, 1, 2, False, '=HYPERLINK("x")\n,', 0.5, 0.1, 3.0)),
        (None, OccupancyMap(6, 0.1, 0.0, 0.0, np.zeros((2, 2), np.int8))),
    ]
    counts = write_csv(tmp_path / "out", messages)
    assert counts == {
        "odom.csv": 1, "scan.csv": 1, "pose.csv": 1, "raw_laser_rx.csv": 1, "loop.csv": 1
    }  # fmt: skip
    (odom,) = rows(tmp_path / "out" / "odom.csv")
    assert odom == {
        "stamp_ns": "5", "receipt_ns": "7", "x": "0.1", "y": repr(1 / 3), "theta": "-2.0"
    }  # fmt: skip
    (scan,) = rows(tmp_path / "out" / "scan.csv")
    again = np.array(scan["ranges"].split(), dtype=np.float32)
    assert again.tobytes() == ranges.tobytes()
    assert scan["receipt_ns"] == "6"
    (raw,) = rows(tmp_path / "out" / "raw_laser_rx.csv")
    assert raw["data"] == "00ff"
    (loop,) = rows(tmp_path / "out" / "loop.csv")
    assert loop["reason"].startswith("'=")


def test_nothing_is_replaced_and_nothing_left_half(tmp_path: Path):
    with pytest.raises(LogError, match="already"):
        write_csv(tmp_path, [])
    with pytest.raises(LogError, match="no message"):
        write_csv(tmp_path / "out", [])
    with pytest.raises(LogError, match="writing failed"):
        write_csv(tmp_path / "no" / "out", [])
    assert list(tmp_path.iterdir()) == []
