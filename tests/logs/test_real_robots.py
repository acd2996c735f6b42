"""Recordings of other people's robots, which stay outside of this repository."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from slam.logs.doctor import Examination
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "real"

# Folder, file in it (empty: the folder itself), options; scans, odometry, mount, seconds, beams.
ROBOTS = [
    ("tb4-mac", "", {}, 357, 920, (0.004, 0.0, 1.5708), 46, 720),
    ("neato24-square", "", {"mount": (-0.1, 0.0, 3.14159)}, 185, 194, (-0.1, 0, 3.14159), 41, 361),
    ("neato24-fsm", "", {"mount": (-0.1, 0.0, 3.14159)}, 280, 301, (-0.1, 0, 3.14159), 63, 361),
    ("neato18-test", "*.bag", {}, 377, 537, (-0.1016, 0.0, -3.14159), 75, 361),
    ("neato18-avoid", "*.bag", {}, 269, 371, (-0.1016, 0.0, -3.14159), 54, 361),
    ("tb3-wall", "*.bag", {}, 339, 0, (0, 0, 0), 68, 360),
    ("rpl-run8", "", {}, 2736, 0, (0, 0, 0), 497, 720),
    ("rpl-run10", "*.mcap", {}, 971, 0, (0, 0, 0), 176, 720),
    ("urg-ccny", "demo.bag", {}, 360, 0, (0, 0, 0), 36, 681),
    ("urg-still", "*.bag", {"scan": "/front_scan"}, 331, 0, (0, 0, 0), 33, 726),
    ("urg-still", "*.bag", {"scan": "/rear_scan"}, 330, 0, (0, 0, 0), 33, 726),
    ("bag-v1.2", "demo.bag", {}, 123, 0, (0, 0, 0), 12, 512),
    ("ydx4-1", "*.txt", {"mount": (0.0, 0.0, 0.0)}, 213, 213, (0, 0, 0), 30, 2005),
]
# What the doctor may say of them by the log alone, because it is so.
TRUE_FINDINGS = {
    "no-odometry": {"tb3-wall", "rpl-run8", "rpl-run10", "urg-ccny", "urg-still", "bag-v1.2"},
    "scan-time": {"tb3-wall"},  # says 0.011 s a sweep, truly 0.2
    "ranges-nan": {"rpl-run8", "rpl-run10", "neato18-test", "neato18-avoid", "neato24-fsm"},
    "beam-count": {"ydx4-1"},
    "blind-scans": {"ydx4-1", "neato24-fsm", "neato18-avoid", "rpl-run10"},
    "clock-unset": {"ydx4-1"},  # it counts from 0
}


def source(folder: str, name: str) -> Path:
    if not (REAL / folder).is_dir():
        pytest.skip(f"recordings of real robots are not at {REAL}")
    return next((REAL / folder).glob(name)) if name else REAL / folder


@pytest.mark.parametrize(
    ("folder", "name", "options", "scans", "odometry", "mount", "seconds", "beams"), ROBOTS
)
def test_a_real_robots_recording_is_imported_whole(
    folder, name, options, scans, odometry, mount, seconds, beams
):
    log = read_any(source(folder, name), Wishes(**options))
    received = list(log.received())
    messages = [message for message, _ in received]
    found = [m for m in messages if isinstance(m, LaserScan)]
    assert len(found) == scans
    assert sum(isinstance(m, WheelOdometry) for m in messages) == odometry
    assert log.skipped == {}
    assert log.warnings == []
    assert log.changed == {}
    place = messages[0]
    assert isinstance(place, LaserExtrinsics)
    assert (place.x, place.y, place.theta) == pytest.approx(mount, abs=1e-3)
    assert (found[-1].stamp_ns - found[0].stamp_ns) * 1e-9 == pytest.approx(seconds, abs=1.5)
    assert len(found[0].ranges) == beams

    examination = Examination()
    for message, receipt_ns in received:
        receipt = message.stamp_ns if receipt_ns is None else receipt_ns
        examination.feed(receipt, message)
    said = {finding.code: finding for finding in examination.findings()}
    wrong = {c: f.text for c, f in said.items() if folder not in TRUE_FINDINGS.get(c, ())}
    assert wrong == {}


def test_two_statements_of_one_mount_are_named():
    for folder in ("neato24-square", "neato24-fsm"):
        log = read_any(source(folder, ""))
        (warning,) = log.warnings
        assert "(-0.102, 0.00, -180.0 deg) and (-0.084, 0.00, 180.0 deg)" in warning


def test_two_lasers_of_equal_rank_are_a_guess():
    (warning,) = read_any(source("urg-still", "*.bag")).warnings
    assert "--scan takes another (/rear_scan)" in warning
