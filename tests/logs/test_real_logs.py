"""Importers on real recordings, which stay outside of this repository."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from slam.logs.importers.detect import read_any
from slam.logs.importers.imported import ImportedLog
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

DATA = Path(__file__).parents[2].parent / "shared" / "data"


def load(name: str) -> ImportedLog:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"real recordings are not at {DATA}")
    return read_any(path)


def relative(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return inverse(a) * b of poses (n, 3)."""
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.stack([c * dx + s * dy, c * dy - s * dx, b[:, 2] - a[:, 2]], axis=1)


@pytest.mark.parametrize(
    ("name", "scans", "tolerance_us", "mean", "std", "backwards"),
    [
        ("intel", 13631, 0, 7.370, 14.349, 631),
        ("mit-csail", 1988, 10, 1.682, 5.292, 0),
        ("mit-killian", 17480, 0, 50.3, 128.1, 0),
    ],
)
def test_raw_odometry_gives_the_known_relation_errors(
    name, scans, tolerance_us, mean, std, backwards
):
    log = load(f"benchmark/{name}.clf.gz")
    assert log.changed["stamps that ran backwards, put in order"] == backwards
    assert not log.skipped
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    stamps = np.array([m.stamp_ns for m in odometry])
    poses = np.array([(m.x, m.y, m.theta) for m in odometry])
    assert len(stamps) == scans
    assert np.all(np.diff(stamps) > 0)

    rows = np.loadtxt(DATA / "benchmark" / f"{name}.relations", dtype=str)
    found = []
    for column in (0, 1):
        wanted = np.array([round(float(t) * 1e6) * 1000 for t in rows[:, column]])
        after = np.searchsorted(stamps, wanted).clip(1, len(stamps) - 1)
        nearest = after - (wanted - stamps[after - 1] < stamps[after] - wanted)
        assert np.abs(stamps[nearest] - wanted).max() <= tolerance_us * 1000
        found.append(nearest)
    truth = rows[:, [2, 3, 7]].astype(float)
    error = relative(truth, relative(poses[found[0]], poses[found[1]]))
    trans = np.hypot(error[:, 0], error[:, 1])
    given_to = 1e-3 if mean < 10 else 0.1
    assert (trans.mean(), trans.std()) == pytest.approx((mean, std), abs=given_to)


def test_every_scan_follows_its_odometry():
    log = load("benchmark/mit-csail.clf.gz")
    assert isinstance(log.messages[0], LaserExtrinsics)
    for odometry, scan in zip(log.messages[1::2], log.messages[2::2], strict=True):
        assert isinstance(odometry, WheelOdometry)
        assert isinstance(scan, LaserScan)
        assert odometry.stamp_ns == scan.stamp_ns
        assert not np.any(scan.ranges[np.isfinite(scan.ranges)] > 50)


def test_the_mount_of_the_freiburg_robot_is_declared():
    extrinsics = load("keyframes/freiburg-101.keyframes.clf.gz").messages[0]
    assert isinstance(extrinsics, LaserExtrinsics)
    assert (extrinsics.x, extrinsics.y, extrinsics.theta) == (-0.04, 0.0, 0.0)


@pytest.mark.parametrize(("name", "scans", "path_m"), [("exp1", 756, 46.0), ("exp2", 641, 44.5)])
def test_breezyslam_logs(name, scans, path_m):
    log = load(f"hokuyo/{name}.dat.gz")
    odometry = [m for m in log.messages if isinstance(m, WheelOdometry)]
    steps = [math.hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(odometry)]
    assert len(odometry) == scans
    assert sum(steps) == pytest.approx(path_m, abs=0.1)
    assert not log.skipped
    scan = log.messages[2]
    assert isinstance(scan, LaserScan)
    assert len(scan.ranges) == 682
    assert math.degrees(scan.angle_min) == pytest.approx(-119.53, abs=0.01)
