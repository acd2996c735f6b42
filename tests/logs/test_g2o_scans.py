from __future__ import annotations

import importlib.util
import zipfile
from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.importers.detect import read_any
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry


def scan_line(stamp: float, first: float = 1.0) -> str:
    return (
        f"ROBOTLASER1 0 -1.5 3.0 0.1 50.0 0.1 0 4 {first} 2 3 51.06 0 "
        f"9 9 9 9 9 9 0 0 0 0 0 {stamp} host 0"
    )


GRAPH = f"""# a graph
VERTEX_SE2 0 5 6 1.0
{scan_line(100.0)}
VERTEX_SE2 1 7 6 1.0
{scan_line(101.0, -1.0)}
VERTEX_SE2 3 8 6 1.0
{scan_line(102.0)}
EDGE_SE2 0 1 2.0 0.5 0.25 500 0 0 500 0 5000
EDGE_SE2 0 3 9.0 0.5 0.25 500 0 0 500 0 5000
VERTEX_XY 9 1 1
EDGE_SE2 1 x
"""


def check(log) -> None:
    assert log.kind == "g2o with scans"
    assert [type(m) for m in log.messages] == [
        LaserExtrinsics,
        *[WheelOdometry, TruePose, LaserScan] * 3,
    ]
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    assert (odometry[0].x, odometry[0].y, odometry[0].theta) == (0.0, 0.0, 0.0)
    assert (odometry[1].x, odometry[1].y, odometry[1].theta) == (2.0, 0.5, 0.25)
    truth = [m for m in log.messages if isinstance(m, TruePose)]
    assert truth[1] == TruePose(101_000_000_000, 7.0, 6.0, 1.0)
    scan = log.messages[3]
    assert scan.ranges.tolist() == [1.0, 2.0, 3.0, np.inf]
    assert log.skipped == {"lines of no known kind": 1, "EDGE_SE2: a field is not a number": 1}
    assert log.ignored == {"EDGE_SE2 that closes a loop": 1}
    assert log.changed == {
        "edges missing between neighbours, taken from the vertices": 1,
        "ranges that were zero, negative or nan, set to nan": 1,
    }


def test_plain_and_zipped(tmp_path: Path):
    (tmp_path / "a.txt").write_text(GRAPH)
    check(read_any(tmp_path / "a.txt"))
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.g2o", GRAPH)
        archive.writestr("__MACOSX/._a.g2o", "shadow")
    check(read_any(tmp_path / "a.zip"))


def test_what_cannot_be_used_is_one_clear_line(tmp_path: Path):
    (tmp_path / "a.g2o").write_text("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    with pytest.raises(LogError, match="without scans"):
        read_any(tmp_path / "a.g2o")
    (tmp_path / "b.zip").write_bytes(b"PK\x03\x04" + bytes(50))
    with pytest.raises(LogError, match=r"b\.zip"):
        read_any(tmp_path / "b.zip")
    with zipfile.ZipFile(tmp_path / "c.zip", "w") as archive:
        archive.writestr("readme", "nothing here")
    with pytest.raises(LogError, match=r"0 \.g2o files"):
        read_any(tmp_path / "c.zip")


def test_a_cut_zip_is_counted_or_refused(tmp_path: Path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.g2o", GRAPH * 50)
    whole = (tmp_path / "a.zip").read_bytes()
    for length in range(4, len(whole), 23):
        (tmp_path / "cut.zip").write_bytes(whole[:length])
        with pytest.raises(LogError, match=r"cut\.zip"):
            read_any(tmp_path / "cut.zip")


def test_the_killian_court_of_rtb_data():
    found = importlib.util.find_spec("rtbdata")
    if found is None or found.origin is None:
        pytest.skip("rtb-data (the extra [demo]) is not installed")
    path = Path(found.origin).parent / "data" / "killian.g2o.zip"
    log = read_any(path)
    scans = [m for m in log.messages if isinstance(m, LaserScan)]
    assert len(scans) == 3873
    assert not log.skipped
    assert log.ignored == {"EDGE_SE2 that closes a loop": 1115}
    last = [m for m in log.messages if isinstance(m, WheelOdometry)][-1]
    assert (last.x, last.y) == pytest.approx((6.963, -16.245), abs=1e-3)
