"""ARIA's laser logs (`.2d`, "LaserOdometryLog"): what owners of a Pioneer have.

A scan is written each time the robot has moved or turned a little: `time:` (s since the
start), `robot:` (the encoders' pose, mm and deg), then `sick1:` with ranges (mm) or `scan1:`
with points x y in the laser's frame (mm, `0 0` for a beam that is not used).  `sick1pose:`
is where the laser sits (mm, deg; y to the left as everywhere in ARIA), `sick1conf:` the
first and the last angle (deg) and the number of beams.  Where both are there, the ranges
are read.  `robotGlobal:` is a localiser's pose and is left out.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from slam.logs.errors import LogError
from slam.logs.importers.imported import ImportedLog, Reading, as_messages, in_stamp_order
from slam.logs.importers.text_lines import lines
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserScan, WheelOdometry

FIRST_WORD = b"LaserOdometryLog"
NOTHING_MM = 32_000.0  # from here on a SICK's reading means that nothing came back
BEAMS_LIMIT = 10_000
_TIME = re.compile(rb"(\d{1,9})(?:\.(\d{1,6}))?")
_NO_WISHES = Wishes()


@dataclass(slots=True)
class _Scan:
    """The lines of one scan, as they come."""

    time: tuple[int, bytes] = (0, b"")  # whole seconds, and digits behind the point
    robot: tuple[float, float, float] | None = None
    ranges: np.ndarray | None = None  # (n,) mm


@dataclass(slots=True)
class _Log:
    """The lines of one file."""

    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    view: tuple[float, float, int] | None = None  # first, last angle (deg), beams
    scans: list[_Scan] = field(default_factory=list)
    now: _Scan = field(default_factory=_Scan)
    skipped: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)

    def feed(self, line: bytes) -> None:
        """Take in one line."""
        tag, colon, rest = line.strip().partition(b":")
        if not colon or tag.startswith(b"#"):
            return
        word = tag.decode("ascii", "replace")
        try:
            self._dispatch(word, rest.split())
        except (ValueError, IndexError):
            self.skipped[f"{word[:20]}: fields that cannot be used"] += 1

    def _dispatch(self, word: str, fields: list[bytes]) -> None:
        if word == "sick1pose":
            x, y, theta = map(float, fields[:3])
            self.mount = x / 1000.0, y / 1000.0, math.radians(theta)
        elif word == "sick1conf":
            self.view = float(fields[0]), float(fields[1]), int(fields[2])
        elif word in ("time", "logTime"):
            match = _TIME.fullmatch(fields[0])
            if match is None:
                raise ValueError
            self.now.time = int(match[1]), match[2] or b""
        elif word == "robot":
            x, y, theta = map(float, fields[:3])
            if not math.isfinite(x + y + theta):
                raise ValueError
            self.now.robot = x / 1000.0, y / 1000.0, math.radians(theta)
        elif word in ("sick1", "scan1"):
            self._add(np.array(fields, dtype=np.float64), pairs=word == "scan1")
        elif word == "cairn":
            self.ignored["goals"] += 1

    def _add(self, values: np.ndarray, pairs: bool) -> None:
        if not 0 < len(values) <= 2 * BEAMS_LIMIT or len(values) % (2 if pairs else 1):
            raise ValueError
        ranges = np.hypot(values[::2], values[1::2]) if pairs else values
        scan, self.now = self.now, _Scan(self.now.time, self.now.robot)
        last = self.scans[-1] if self.scans else None
        if pairs and last is not None and (last.time, last.robot) == (scan.time, scan.robot):
            return  # the same scan as points
        if scan.robot is None:
            self.skipped["scans before any pose of the robot"] += 1
            return
        scan.ranges = ranges
        self.scans.append(scan)


def read_aria(path: Path | str, wishes: Wishes = _NO_WISHES) -> ImportedLog:
    """Read a laser log of ARIA into messages in stamp order; stamps count from its start.

    Raises:
        LogError: it cannot be read, holds no usable scan, or does not say how wide it looks.
    """
    path = Path(path)
    log = _Log()
    for line in lines(path, log.skipped):
        log.feed(line)
    if not log.scans:
        raise LogError(f"{path}: is a laser log of ARIA, but holds no usable scan")
    view = log.view
    if wishes.view_deg:
        view = -wishes.view_deg / 2, wishes.view_deg / 2, 0
    if view is None:
        raise LogError(f"{path}: has no line sick1conf: say --fov DEGREES")
    # Old loggers wrote whole milliseconds behind the point, 1.5 for 1.005 s.
    unpadded = len({len(scan.time[1]) for scan in log.scans}) > 1
    changed: Counter[str] = Counter()
    readings = []
    for scan in log.scans:
        assert scan.robot is not None
        assert scan.ranges is not None
        if view[2] and len(scan.ranges) != view[2]:
            log.skipped["scans of another number of beams than sick1conf says"] += 1
            continue
        stamp = _stamp_ns(scan.time, unpadded)
        odometry = WheelOdometry(stamp, *scan.robot)
        readings.append(Reading(odometry, _scan(stamp, scan.ranges, view)))
    try:
        ordered = in_stamp_order(readings, changed, log.skipped, wishes)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    if not ordered:
        raise LogError(f"{path}: no scan has as many beams as sick1conf says")
    messages = as_messages(ordered, log.mount, wishes)
    return ImportedLog("ARIA", messages, log.skipped, changed, log.ignored)


def _stamp_ns(time: tuple[int, bytes], unpadded: bool) -> int:
    seconds, digits = time
    if unpadded and len(digits) <= 3:
        return seconds * 10**9 + int(digits or b"0") * 10**6
    return seconds * 10**9 + int(digits.ljust(9, b"0"))


def _scan(stamp_ns: int, ranges_mm: np.ndarray, view: tuple[float, float, int]) -> LaserScan:
    first, last = math.radians(view[0]), math.radians(view[1])
    ranges = ranges_mm / 1000.0
    ranges[ranges_mm >= NOTHING_MM] = np.inf
    ranges[~(ranges_mm > 0)] = np.nan
    step = (last - first) / max(len(ranges) - 1, 1)
    return LaserScan(
        stamp_ns, first, step, ranges.astype(np.float32), range_max=NOTHING_MM / 1000.0
    )
