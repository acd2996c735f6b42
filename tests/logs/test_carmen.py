from __future__ import annotations

import gzip
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.logs.errors import LogError
from slam.logs.exporters.carmen import carmen_lines, write_carmen
from slam.logs.importers.carmen import read_carmen
from slam.logs.importers.carmen_lines import SENTINEL_M, parse_stamp
from slam.logs.importers.detect import read_any
from slam.logs.importers.imported import ImportedLog
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

from tests.logs.strategies import content


def flaser(
    stamp: str = "1.5",
    ranges: list[object] | None = None,
    laser: str = "1 2 0.5",
    robot: str = "1 2 0.5",
    n: int | None = None,
) -> str:
    values = [1.0] * 180 if ranges is None else ranges
    count = len(values) if n is None else n
    return f"FLASER {count} {' '.join(map(str, values))} {laser} {robot} {stamp} host 0.1\n"


def read(tmp_path: Path, *lines: str) -> ImportedLog:
    path = tmp_path / "log.clf"
    path.write_text("".join(lines))
    return read_carmen(path)


def scans_of(log: ImportedLog) -> list[LaserScan]:
    return [m for m in log.messages if isinstance(m, LaserScan)]


def test_mount_then_odometry_and_scan_of_one_stamp(tmp_path: Path):
    log = read(tmp_path, "# a comment\n", flaser("1.5"), flaser("1.75", robot="3 4 1"))
    kinds = [type(m) for m in log.messages]
    assert kinds == [LaserExtrinsics, WheelOdometry, LaserScan, WheelOdometry, LaserScan]
    assert [m.stamp_ns for m in log.messages] == [1_500_000_000] * 3 + [1_750_000_000] * 2
    assert log.messages[1] == WheelOdometry(1_500_000_000, 1.0, 2.0, 0.5)
    assert not log.skipped


@pytest.mark.parametrize(
    ("n", "step_deg", "last_deg"),
    [(180, 1.0, 89.0), (181, 1.0, 90.0), (360, 0.5, 89.5), (361, 0.5, 90.0)],
)
def test_beams_of_a_sick_begin_at_minus_90_degrees(tmp_path: Path, n, step_deg, last_deg):
    (scan,) = scans_of(read(tmp_path, flaser(ranges=[1.0] * n)))
    assert math.degrees(scan.angle_min) == -90.0
    assert math.isclose(math.degrees(scan.angle_step), step_deg)
    assert math.isclose(math.degrees(scan.angle_min + (n - 1) * scan.angle_step), last_deg)


@pytest.mark.parametrize("code", ["81.83", "81.91", "51.2", "51.06", "50", "inf", "1e30"])
def test_codes_for_nothing_came_back_are_infinite(tmp_path: Path, code):
    (scan,) = scans_of(read(tmp_path, flaser(ranges=[code, "49.9", *["2"] * 178])))
    assert scan.ranges[0] == np.inf
    assert scan.ranges[1] == np.float32(49.9)
    assert scan.range_max == SENTINEL_M


def test_a_declared_reach_replaces_the_rule_of_50_m(tmp_path: Path):
    line = flaser(ranges=["81.83", "60", *["2"] * 178])
    (scan,) = scans_of(read(tmp_path, "PARAM robot_front_laser_max 81.92 nohost 0\n", line))
    assert scan.ranges[:2].tolist() == [np.inf, 60.0]


def test_unusable_ranges_become_nan_and_are_counted(tmp_path: Path):
    log = read(tmp_path, flaser(ranges=["nan", "-1", "0", "-inf", *["2"] * 176]))
    assert np.isnan(scans_of(log)[0].ranges[:4]).all()
    assert sum(log.changed.values()) == 4


def test_stamps_that_run_backwards_are_put_in_order_and_counted(tmp_path: Path):
    stamps = ["5.0", "4.8", "4.9", "4.9", "4.6"]
    lines = [flaser(s, robot=f"{k} 0 0") for k, s in enumerate(stamps)]
    log = read(tmp_path, *lines)
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    assert [(m.stamp_ns / 1e9, m.x) for m in odometry] == [
        (4.6, 4), (4.8, 1), (4.9, 2), (4.9, 3), (5, 0),
    ]  # fmt: skip
    assert log.changed["stamps that ran backwards, put in order"] == 2
    assert log.changed["scans with the stamp of another, kept"] == 1


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        (flaser(n=179), "wrong number of fields"),
        (flaser(n=181), "wrong number of fields"),
        (flaser(n=999999999), "impossible number of beams"),
        (flaser(n=-3), "impossible number of beams"),
        (flaser()[:400] + "\n", "wrong number of fields"),
        (flaser(ranges=["1.0x"] * 180), "not a number"),
        (flaser(robot="nan 0 0"), "pose is not finite"),
        (flaser(stamp="yesterday"), "stamp is not a time"),
        (flaser(stamp="-1"), "stamp is not a time"),
        ("FLASER\n", "no number of beams"),
        ("\x00\x01 binary\n", "no known kind"),
        ("ROBOTLASER1 0 -1 3 0 80 0.01 0 1 2.0 0 0 0 0 0 0 0 0 0 0 0 0 1.5 h 1\n", "no angle"),
        ("PARAM robot_frontlaser_offset wide nohost 0\n", "not a number"),
        ("x" * 3_000_000 + "\n", "too long"),
    ],
)
def test_a_line_that_cannot_be_used_is_skipped_and_counted(tmp_path: Path, line, cause):
    log = read(tmp_path, flaser("1.0"), line, flaser("2.0"))
    assert len(scans_of(log)) == 2
    ((said, count),) = log.skipped.items()
    assert cause in said
    assert count == 1


def test_without_a_usable_scan_there_is_one_clear_line(tmp_path: Path):
    for lines, said in [
        ([flaser(n=179)] * 3, "3 x FLASER: wrong number of fields"),
        (["ODOM 0 0 0 0 0 0 1.0 h 1.0\n"], "no FLASER or ROBOTLASER1"),
        (["RAWLASER1 0 0 0 0 0 0 0 0 0 1 h 1\n"], "impossible number of beams"),
    ]:
        with pytest.raises(LogError, match=said) as caught:
            read(tmp_path, *lines)
        assert "log.clf" in str(caught.value)
    (tmp_path / "empty").touch()
    for path, said in [("empty", "empty"), ("nowhere", "no such file"), ("", "folder")]:
        with pytest.raises(LogError, match=said):
            read_carmen(tmp_path / path)


def test_robotlaser_brings_its_own_geometry(tmp_path: Path):
    line = (
        "ROBOTLASER1 0 -2.0 3.0 0.25 5.6 0.01 0 4 1.0 5.6 5.5 2.0 2 17 18 "
        "1.1 2.0 0.0 1.0 2.0 0.0 0 0 0 0 0 7.25 host 0.5\n"
    )
    log = read(tmp_path, line)
    (scan,) = scans_of(log)
    assert (scan.angle_min, scan.angle_step, scan.stamp_ns) == (-2.0, 0.25, 7_250_000_000)
    assert scan.ranges.tolist() == [1.0, np.inf, 5.5, 2.0]
    extrinsics = log.messages[0]
    assert isinstance(extrinsics, LaserExtrinsics)
    assert (extrinsics.x, extrinsics.y) == (pytest.approx(0.1), 0.0)
    assert log.messages[1] == WheelOdometry(7_250_000_000, 1.0, 2.0, 0.0)


def test_the_mount_comes_from_poses_or_parameters(tmp_path: Path):
    offset = "PARAM robot_frontlaser_offset -0.04 nohost 0\n"
    turned = flaser(laser="1 2.3 1.5", robot="1 2 1.5707963267948966")
    assert read(tmp_path, offset, flaser()).messages[0].x == -0.04
    extrinsics = read(tmp_path, offset, turned).messages[0]
    assert (extrinsics.x, extrinsics.y, extrinsics.theta) == pytest.approx(
        (0.3, 0.0, 1.5 - math.pi / 2)
    )
    loose = read(tmp_path, flaser(laser="1 2 0"), flaser("2.0", laser="1.5 2 0"))
    assert (loose.messages[0].x, loose.messages[0].y) == (0.0, 0.0)
    assert any("not rigid" in cause for cause in loose.changed)


def test_gzip_is_read_and_its_damage_counted(tmp_path: Path):
    text = "".join(flaser(f"{k}.5", ranges=[f"{1 + k * 0.37:.2f}"] * 180) for k in range(200))
    path = tmp_path / "log.clf.gz"
    path.write_bytes(gzip.compress(text.encode()))
    assert len(scans_of(read_carmen(path))) == 200
    path.write_bytes(gzip.compress(text.encode())[:-1000])
    log = read_carmen(path)
    assert 0 < len(scans_of(log)) < 200
    assert any("gzip" in cause for cause in log.skipped)


def test_stamps_are_exact_to_the_nanosecond():
    assert parse_stamp(b"976052857.337530") == 976_052_857_337_530_000
    assert parse_stamp(b"1134864645.903210001") == 1_134_864_645_903_210_001
    assert parse_stamp(b"7") == 7_000_000_000
    assert parse_stamp(b"1.5e3") == 1_500_000_000_000
    for bad in (b"nan", b"-1", b"1e300", b"9999999999", b"", b"."):
        with pytest.raises(ValueError, match="not a"):
            parse_stamp(bad)


number = st.floats(-1e6, 1e6)
ranges = npst.arrays(
    np.float32,
    st.integers(1, 40),
    elements=st.one_of(
        st.floats(0, 49, width=32, exclude_min=True), st.just(np.inf), st.just(np.nan)
    ),
)


@st.composite
def carmen_scans(draw, stamp_ns: int) -> LaserScan:
    readings = draw(ranges)
    if draw(st.booleans()) and len(readings) > 1:  # the geometry of a FLASER line
        n = len(readings)
        return LaserScan(
            stamp_ns, -math.pi / 2, math.pi / (n - n % 2), readings, range_max=SENTINEL_M
        )
    start, step = draw(number), draw(number.filter(lambda value: value != 0))
    return LaserScan(stamp_ns, start, step, readings, range_max=SENTINEL_M)


@st.composite
def carmen_logs(draw):
    extrinsics = tuple(draw(st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3))))
    stamps = sorted(draw(st.sets(st.integers(0, 2**33 * 10**9 - 1), min_size=1, max_size=5)))
    messages = [LaserExtrinsics(stamps[0], *extrinsics)]
    for stamp in stamps:
        pose = draw(st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-3, 3)))
        messages += [WheelOdometry(stamp, *pose), draw(carmen_scans(stamp))]
    return messages


@given(carmen_logs())
@settings(max_examples=150, deadline=None)
def test_export_then_import_is_exact(messages):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.clf"
        written = write_carmen(path, messages)
        log = read_any(path)
    assert written == len(scans_of(log))
    assert not log.skipped
    extrinsics, *rest = log.messages
    assert extrinsics == messages[0]
    assert list(map(without_reach, rest)) == list(map(without_reach, messages[1:]))


def without_reach(message) -> tuple[object, ...]:
    """The reach alone is written as a nominal value and may come back an ulp off."""
    if isinstance(message, LaserScan):
        assert message.range_max == pytest.approx(SENTINEL_M, rel=1e-15)
        return (*content(message)[:5], np.isnan(message.ranges).tobytes())
    return content(message)


@given(npst.arrays(np.float32, 400, elements=st.floats(0.001953125, 49, width=32)))
@settings(max_examples=50, deadline=None)
def test_ranges_are_written_short_and_exact(values):
    scan = LaserScan(0, 0.0, 0.01, values, range_max=SENTINEL_M)
    line = list(carmen_lines([scan]))[-1]
    again = np.array(line.split()[9:409], dtype=np.float64).astype(np.float32)
    assert again.tobytes() == values.tobytes()


def test_exporting_nothing_is_refused(tmp_path: Path):
    with pytest.raises(LogError, match="no scan"):
        write_carmen(tmp_path / "a.clf", [WheelOdometry(0, 0.0, 0.0, 0.0)])
    assert list(tmp_path.iterdir()) == []
