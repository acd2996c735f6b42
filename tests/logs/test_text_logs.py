"""Text logs of other robots: what is read, what is asked for, and what is named."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry


def read(path: Path, text: str, **wishes):
    path.write_text(text)
    log = read_any(path, Wishes(**wishes))
    scans = [m for m in log.messages if isinstance(m, LaserScan)]
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    return log, scans, odometry


def flaser(stamp: float, x: float, n: int = 180) -> str:
    return f"FLASER {n} {'1.5 ' * n}{x} 0 0 {x} 0 0 {stamp} host {stamp}\n"


def raw(stamp: float, n: int = 5) -> str:
    return f"RAWLASER1 0 -1.0 2.0 0.5 30.0 0.01 0 {n} {'1.5 ' * n}0 {stamp} host {stamp}\n"


def odom(stamp: float, x: float) -> str:
    return f"ODOM {x} 0 0 0.5 0 0 {stamp} host {stamp}\n"


def test_r26_raw_lasers_between_odometry_lines(tmp_path):
    lines = "".join(odom(1 + 0.1 * k, 0.1 * k) + raw(1.03 + 0.1 * k) for k in range(10))
    log, scans, wheels = read(tmp_path / "raw.clf", lines)
    assert (len(scans), len(wheels)) == (10, 10)
    assert not log.skipped
    assert scans[0].angle_min == -1.0
    assert scans[0].angle_step == 0.5
    assert [m.x for m in wheels] == pytest.approx([0.1 * k for k in range(10)])
    assert log.notes == ["scans from RAWLASER1, odometry from ODOM"]
    alone, scans, wheels = read(tmp_path / "alone.clf", raw(1.0) + raw(1.1))
    assert (len(scans), len(wheels)) == (2, 0)
    assert "laser alone" in alone.notes[0]
    _, scans, wheels = read(tmp_path / "both.clf", lines + flaser(3.0, 1.0))
    assert (len(scans), len(wheels)) == (1, 1)


def test_r26_a_wide_flaser_needs_its_field_of_view(tmp_path):
    text = flaser(1.0, 0.0, 1081) + flaser(1.1, 0.1, 1081)
    with pytest.raises(LogError, match=r"2 x FLASER: more beams than a SICK has.*--fov DEGREES"):
        read(tmp_path / "wide.clf", text)
    _, scans, _ = read(tmp_path / "wide.clf", text, view_deg=270.0)
    assert scans[0].angle_min == pytest.approx(-math.radians(135))
    assert scans[0].angle_step == pytest.approx(math.radians(0.25))
    _, scans, _ = read(tmp_path / "sick.clf", flaser(1.0, 0.0, 361))
    assert scans[0].angle_step == pytest.approx(math.radians(0.5))


def test_r08_two_drives_in_one_text_are_never_shuffled(tmp_path):
    first = [flaser(1 + 0.1 * k, 0.1 * k) for k in range(20)]
    second = [flaser(1.05 + 0.1 * k, -0.1 * k) for k in range(20)]
    text = "".join(first + second)
    with pytest.raises(LogError, match=r"two\.clf: holds 2 drives: time steps back by 1\.85 s"):
        read(tmp_path / "two.clf", text)
    _, _, wheels = read(tmp_path / "two.clf", text, drive=2)
    assert [m.x for m in wheels] == pytest.approx([-0.1 * k for k in range(20)])


def test_mount_and_span_can_be_given_for_texts(tmp_path):
    text = "".join(flaser(1 + 0.1 * k, 0.1 * k) for k in range(20))
    log, scans, _ = read(tmp_path / "a.clf", text, mount=(0.1, 0.2, 0.3), start_s=0.45, end_s=1.0)
    extrinsics = log.messages[0]
    assert isinstance(extrinsics, LaserExtrinsics)
    assert (extrinsics.x, extrinsics.y, extrinsics.theta) == (0.1, 0.2, 0.3)
    assert len(scans) == 6
    with pytest.raises(LogError, match="no ROS recording: leave --scan and --base out"):
        read(tmp_path / "a.clf", text, scan="/scan", base="base_link")


def rover(n: int, count: int = 3, trailing: str = " 0") -> str:
    rows = [
        " ".join(map(str, [1000 * k, 0, 10 * k, 10 * k, *[0] * 20, *[1500] * n])) + trailing
        for k in range(count)
    ]
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize(("n", "trailing"), [(360, ""), (683, " 0"), (682 - 2, ""), (361, " 0")])
def test_r29_breezyslam_of_another_laser_is_named(tmp_path, n, trailing):
    with pytest.raises(LogError, match=f"BreezySLAM with {n} ranges: only the rover's 682"):
        read(tmp_path / "x.dat", rover(n, trailing=trailing))
    log, scans, wheels = read(tmp_path / "x.dat", rover(n, trailing=trailing), view_deg=240.0)
    assert (len(scans), len(wheels)) == (3, 0)
    assert len(scans[0].ranges) == n
    assert "laser alone" in log.notes[0]


ARIA = """LaserOdometryLog
#Created by ARIA's ArLaserLogger
version: 2
sick1pose: 16 5 90.00
sick1conf: -90 90 5
"""


def test_r29_arias_logs_with_ranges_or_points(tmp_path):
    ranges = "".join(
        f"scan1Id: {k}\ntime: 1.{5 * k}\nrobot: {100 * k} 0 45.00\nsick1: 1000 0 2000 3000 32767\n"
        for k in range(30)
    )
    log, scans, wheels = read(tmp_path / "aria.2d", ARIA + ranges + "# End of log\n")
    assert log.kind == "ARIA"
    assert (len(scans), len(wheels)) == (30, 30)
    assert [m.stamp_ns for m in scans[:3]] == [10**9, 1_005_000_000, 1_010_000_000]
    assert (wheels[2].x, wheels[2].theta) == pytest.approx((0.2, math.pi / 4))
    mount = log.messages[0]
    assert isinstance(mount, LaserExtrinsics)
    assert (mount.x, mount.y, mount.theta) == pytest.approx((0.016, 0.005, math.pi / 2))
    assert scans[0].angle_min == pytest.approx(-math.pi / 2)
    assert scans[0].angle_step == pytest.approx(math.pi / 4)
    np.testing.assert_equal(scans[0].ranges, np.float32([1, np.nan, 2, 3, np.inf]))
    points = "time: 0.100\nrobot: 0 0 0\nscan1: 0 -1000  0 0  2000 0  0 0  0 3000\n"
    _, scans, _ = read(tmp_path / "points.2d", ARIA + points)
    np.testing.assert_equal(scans[0].ranges, np.float32([1, np.nan, 2, np.nan, 3]))
    with pytest.raises(LogError, match="laser log of ARIA, but holds no usable scan"):
        read(tmp_path / "none.2d", ARIA)


def test_what_cannot_be_read_is_named(tmp_path):
    rawlog = tmp_path / "x.rawlog"
    with gzip.open(rawlog, "wb") as file:
        file.write(b"\x97CObservation2DRangeScan\x06\x00\x01" + bytes(200))
    with pytest.raises(LogError, match="rawlog of MRPT without a 2D scan that can be read"):
        read_any(rawlog)
    with gzip.open(rawlog, "wb") as file:
        file.write(b"#ROSBAG V2.0\n" + bytes(5000))
    with pytest.raises(LogError, match="packed with gzip: unpack it first"):
        read_any(rawlog)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.mcap").touch()
    with pytest.raises(LogError, match="is a RUN, not a recording"):
        read_any(tmp_path / "run")
    with pytest.raises(LogError, match="pose graph without scans: `slam reoptimise`"):
        read(tmp_path / "a.graph", "VERTEX2 0 0 0 0\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n")


def test_text_of_a_ydlidar(tmp_path):
    row = ", ".join(map(str, [100.0, 90.0, 0.1, *[1.5, 0.0, 20.0, 0.05] * 40]))
    log, scans, wheels = read(tmp_path / "x.txt", f"{row}, \n{row}\n")
    assert log.kind == "YDLidar text"
    assert [m.stamp_ns for m in scans] == [0, 100_000_000]
    assert scans[0].angle_step == pytest.approx(math.tau / 160)
    np.testing.assert_equal(scans[0].ranges[:4], np.float32([1.5, np.inf, np.inf, np.nan]))
    assert (wheels[1].x, wheels[1].y) == pytest.approx((0.1 * math.sqrt(0.5),) * 2)
    assert len(log.warnings) == 1
