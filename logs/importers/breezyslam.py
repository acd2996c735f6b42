"""Logs of BreezySLAM's rover: a Hokuyo URG-04LX and wheel ticks, one line a scan.

Columns, counted from 0: 0 time (us), 2 and 3 ticks of the left and right wheel, from 24 on
682 ranges (mm, anticlockwise) and one more value that is not used.  The rover is fixed:
wheel radius 77 mm, half axle 165 mm, laser 145 mm ahead of the axle, 2000 ticks a turn of
a wheel.  (Descriptions of the data say 180 degrees for 2000 ticks and use it with a sum
where a mean belongs.  The scans decide: laid over each other six scans apart they agree
best at 2.0 times the distance and 1.8 times the turn that 4000 ticks a turn would give.)
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
from slam.logs.messages import LaserScan, WheelOdometry

BEAMS = 682
FIRST_RANGE = 24
FIELDS = FIRST_RANGE + BEAMS + 1

_TICK_RAD = math.tau / 2000
_WHEEL_RADIUS_M, _HALF_AXLE_M = 0.077, 0.165
_LASER_AHEAD_M = 0.145

_STEP_RAD = math.tau / 1024  # URG-04LX: 1024 steps a turn, the beams are steps 44 to 725
_FIRST_BEAM_RAD = (44 - 384) * _STEP_RAD  # step 384 looks ahead
_BEAM_PERIOD_S = 0.1 / 1024
_RANGE_MIN_M, _RANGE_MAX_M = 0.02, 5.6
_MARGIN = 70
"""Beams at either end that see the rover itself (BreezySLAM's detection margin)."""


def read_breezyslam(path: Path | str) -> ImportedLog:
    """Read a BreezySLAM log into messages in stamp order.

    A range of 0 is inf; 1 to 19 mm, the sensor's error codes, and the margins are nan.

    Raises:
        LogError: if the file cannot be read or holds no usable line.
    """
    path = Path(path)
    skipped: Counter[str] = Counter()
    changed: Counter[str] = Counter()
    readings = in_stamp_order(_readings(path, skipped), changed)
    if not readings:
        raise LogError(f"{path}: holds no line of {FIELDS} whole numbers: is it a BreezySLAM log?")
    return ImportedLog(
        "BreezySLAM", as_messages(readings, (_LASER_AHEAD_M, 0.0, 0.0)), skipped, changed
    )


def _readings(path: Path, skipped: Counter[str]) -> Iterator[Reading]:
    x = y = theta = 0.0
    last: tuple[int, int] | None = None
    for line in lines(path, skipped):
        fields = line.split()
        if not fields:
            continue
        if len(fields) != FIELDS:
            skipped["wrong number of fields"] += 1
            continue
        try:
            stamp_us, left, right = int(fields[0]), int(fields[2]), int(fields[3])
            ranges_mm = np.array(list(map(int, fields[FIRST_RANGE:-1])), dtype=np.float64)
        except (ValueError, OverflowError):
            skipped["a field is not a whole number"] += 1
            continue
        if not 0 <= stamp_us < 2**53:
            skipped["stamp is not a time"] += 1
            continue
        if last is not None:
            forward, turn = _motion(left - last[0], right - last[1])
            x += forward * math.cos(theta + turn / 2)
            y += forward * math.sin(theta + turn / 2)
            theta = math.remainder(theta + turn, math.tau)
        last = left, right
        stamp_ns = stamp_us * 1000
        yield Reading(WheelOdometry(stamp_ns, x, y, theta), _scan(stamp_ns, ranges_mm))


def _motion(left_ticks: int, right_ticks: int) -> tuple[float, float]:
    """Return how far the axle's middle went (m) and how much it turned (rad)."""
    left = left_ticks * _TICK_RAD * _WHEEL_RADIUS_M
    right = right_ticks * _TICK_RAD * _WHEEL_RADIUS_M
    return (left + right) / 2, (right - left) / (2 * _HALF_AXLE_M)


def _scan(stamp_ns: int, ranges_mm: np.ndarray) -> LaserScan:
    ranges = ranges_mm / 1000.0
    ranges[ranges_mm == 0] = np.inf
    ranges[(ranges_mm < 0) | ((ranges_mm > 0) & (ranges_mm < 20))] = np.nan
    ranges[:_MARGIN] = ranges[-_MARGIN:] = np.nan
    return LaserScan(
        stamp_ns,
        _FIRST_BEAM_RAD,
        _STEP_RAD,
        ranges.astype(np.float32),
        _RANGE_MIN_M,
        _RANGE_MAX_M,
        _BEAM_PERIOD_S,
    )
