"""Text of a YDLidar X4 on a small robot: one row a turn, numbers with commas between.

Columns: how far the robot drove since the row before (mm), how much it turned (deg), the
time since then (s), then the ranges of a whole turn (m), 0 where nothing came back, beam 0
ahead.  The public set names no directions; anticlockwise is taken.  What the first row says
of a time before it is left out.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from slam.logs.errors import LogError
from slam.logs.importers.imported import ImportedLog, Reading, as_messages, in_stamp_order
from slam.logs.importers.text_lines import lines
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserScan, WheelOdometry

LEAST_BEAMS, BEAMS_LIMIT = 100, 10_000
RANGE_MIN_M, RANGE_MAX_M = 0.12, 10.0  # of an X4
LONGEST_STEP_S = 3600.0
_NO_WISHES = Wishes()


def looks_like_ydlidar(line: bytes) -> bool:
    """Whether a line may be a row of this kind."""
    if not LEAST_BEAMS <= line.count(b","):
        return False
    try:
        return bool(np.isfinite([float(field) for field in line.split(b",", 6)[:6]]).all())
    except ValueError:
        return False


def read_ydlidar(path: Path | str, wishes: Wishes = _NO_WISHES) -> ImportedLog:
    """Read such a text into messages in stamp order; stamps count from its first row.

    Raises:
        LogError: it cannot be read or holds no usable row.
    """
    path = Path(path)
    skipped: Counter[str] = Counter()
    changed: Counter[str] = Counter()
    try:
        readings = in_stamp_order(_readings(path, skipped), changed, skipped, wishes)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    if not readings:
        raise LogError(f"{path}: holds no usable row: is it text of a YDLidar?")
    warnings = [
        "the format does not say where beam 0 looks nor which way the laser turns: ahead and "
        "anticlockwise are taken, --mount turns it"
    ]
    messages = as_messages(readings, (0.0, 0.0, 0.0), wishes)
    return ImportedLog(
        "YDLidar text", messages, skipped, changed, warnings=[] if wishes.mount else warnings
    )


def _readings(path: Path, skipped: Counter[str]) -> Iterator[Reading]:
    x = y = theta = 0.0
    stamp_ns = -1
    for line in lines(path, skipped):
        fields = line.strip().strip(b",").split(b",")
        if fields == [b""]:
            continue
        try:
            values = np.array([float(field) for field in fields])
        except ValueError:
            skipped["a field is not a number"] += 1
            continue
        if not 3 < len(values) <= BEAMS_LIMIT or not np.isfinite(values[:3]).all():
            skipped["wrong number of fields"] += 1
            continue
        if not 0 <= values[2] < LONGEST_STEP_S:
            skipped["time since the row before is impossible"] += 1
            continue
        if stamp_ns < 0:
            stamp_ns = 0
        else:
            stamp_ns += round(values[2] * 1e9)
            turned = math.radians(values[1])
            x += values[0] / 1000.0 * math.cos(theta + turned / 2)
            y += values[0] / 1000.0 * math.sin(theta + turned / 2)
            theta = math.remainder(theta + turned, math.tau)
        yield Reading(WheelOdometry(stamp_ns, x, y, theta), _scan(stamp_ns, values[3:]))


def _scan(stamp_ns: int, ranges: np.ndarray) -> LaserScan:
    found = ranges.copy()
    found[(ranges <= 0) | (ranges >= RANGE_MAX_M)] = np.inf
    found[(ranges > 0) & (ranges < RANGE_MIN_M)] = np.nan
    found[np.isnan(ranges)] = np.nan
    return LaserScan(
        stamp_ns, 0.0, math.tau / len(found), found.astype(np.float32), RANGE_MIN_M, RANGE_MAX_M
    )
