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
from slam.logs.importers.wishes import Wishes
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
_LEAST_BEAMS = 100  # of a laser of any kind
_MARGIN = 70
"""Beams at either end that see the rover itself (BreezySLAM's detection margin)."""


_NO_WISHES = Wishes()


def read_breezyslam(path: Path | str, wishes: Wishes = _NO_WISHES) -> ImportedLog:
    """Read a BreezySLAM log into messages in stamp order.

    A range of 0 is inf; 1 to 19 mm, the sensor's error codes, and the margins are nan.  The
    scans of another robot are read where their field of view is given; its wheels are not
    known and left out.

    Raises:
        LogError: if the file cannot be read, holds no usable line, or is of another robot.
    """
    path = Path(path)
    skipped: Counter[str] = Counter()
    changed: Counter[str] = Counter()
    beams = _beams(path)
    notes = []
    if beams not in (0, BEAMS):
        if not wishes.view_deg:
            raise LogError(
                f"{path}: looks like BreezySLAM with {beams} ranges: only the rover's {BEAMS} are "
                "known; say --fov DEGREES to read the scans alone"
            )
        notes.append(f"{beams} ranges over {wishes.view_deg:g} deg, no odometry: laser alone")
        read, mount = _other_readings(path, beams, wishes.view_deg, skipped), (0.0, 0.0, 0.0)
    else:
        read, mount = _readings(path, skipped), (_LASER_AHEAD_M, 0.0, 0.0)
    try:
        readings = in_stamp_order(read, changed, skipped, wishes)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    if not readings:
        raise LogError(f"{path}: holds no line of {FIELDS} whole numbers: is it a BreezySLAM log?")
    messages = as_messages(readings, mount, wishes)
    return ImportedLog("BreezySLAM", messages, skipped, changed, notes=notes)


def looks_like_breezyslam(fields: list[bytes]) -> bool:
    """Whether a line may be a scan of BreezySLAM: whole numbers, a time, and many ranges."""
    few = len(fields) < FIRST_RANGE + _LEAST_BEAMS
    return not few and all(field.lstrip(b"-").isdigit() for field in fields)


def _beams(path: Path) -> int:
    """Return the number of ranges in the first line, 0 if it is empty.

    All known loggers write one value more behind them; a file of a round number has none.
    """
    for line in lines(path, Counter()):
        if fields := line.split():
            if len(fields) == FIELDS:
                return BEAMS
            n = len(fields) - FIRST_RANGE
            return n if n % 10 == 0 else n - 1
    return 0


def _other_readings(
    path: Path, beams: int, view_deg: float, skipped: Counter[str]
) -> Iterator[Reading]:
    view = math.radians(view_deg)
    step = view / (beams if view_deg == 360.0 else beams - 1)
    for line in lines(path, skipped):
        fields = line.split()
        if not fields:
            continue
        try:
            stamp_us = int(fields[0])
            ranges_mm = np.array(list(map(int, fields[FIRST_RANGE:][:beams])), dtype=np.float64)
        except (ValueError, OverflowError):
            skipped["a field is not a whole number"] += 1
            continue
        if len(ranges_mm) != beams or not 0 <= stamp_us < 2**53:
            skipped["wrong number of fields"] += 1
            continue
        ranges = ranges_mm / 1000.0
        ranges[ranges_mm == 0] = np.inf
        ranges[ranges_mm < 0] = np.nan
        yield Reading(scan=LaserScan(stamp_us * 1000, -view / 2, step, ranges.astype(np.float32)))


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
