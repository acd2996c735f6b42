"""Rawlogs of MRPT: a gzipped stream of serialised objects, some of which are scans and odometry.

An object is a byte 0x80 | length of the class name, the name, a version, the fields (little
endian) and the flag 0x88; members that are objects stand between the fields in the same form.
There is no length, so that what is not known cannot be stepped over: objects are looked for by
their headers, and one counts only if its fields end at its flag (MRPT: CArchive,
CObservation2DRangeScan versions 4 to 8, CObservationOdometry 0 to 2, CActionRobotMovement2D 2
to 7, CPose3D 2, CPose2D 0 and 1).
"""

from __future__ import annotations

import gzip
import math
import re
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from slam.logs.errors import LogError
from slam.logs.importers.imported import ImportedLog, Reading, as_messages, in_stamp_order
from slam.logs.importers.rawlog_objects import Moved, Scan, Wheels, read_object
from slam.logs.importers.text_lines import open_text
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserScan, WheelOdometry

_FIRST = re.compile(rb"[\x80-\xff](?:mrpt::obs::)?C(?:Action|SensoryFrame|Observation|Rawlog)")
_SIZE_LIMIT = 1 << 30  # bytes unpacked
_HEADER = re.compile(
    rb"[\x80-\xff](?:mrpt::obs::)?"
    rb"(?:CObservation2DRangeScan|CObservationOdometry|CActionRobotMovement2D)(?=[\x00-\x0f])"
)
_LEVEL = 0.9  # cosine of the angle between the laser's axis and the vertical, at least
_NO_WISHES = Wishes()


def is_rawlog(path: Path) -> bool:
    """Whether a file begins with an object of MRPT, packed or not."""
    try:
        with open_text(path) as file:
            return _FIRST.match(file.read(64)) is not None
    except (LogError, OSError, EOFError, zlib.error):
        return False


def read_rawlog(path: Path, wishes: Wishes = _NO_WISHES) -> ImportedLog:
    """Read a rawlog's scans and odometry, absolute or in steps, in stamp order.

    Raises:
        LogError: it cannot be read, holds no usable scan, or several drives.
    """
    skipped: Counter[str] = Counter()
    changed: Counter[str] = Counter()
    ignored: Counter[str] = Counter()
    notes: list[str] = []
    warnings: list[str] = []
    objects = list(_objects(_unpacked(path, skipped), skipped))
    label = _chosen(path, objects, wishes, ignored, warnings)
    mounts = Counter(s.mount for s in objects if isinstance(s, Scan) and s.label == label)
    ((x, y, theta, up), _), *others = mounts.most_common()
    if abs(up) < _LEVEL:
        raise LogError(f"{path}: the laser {label or 'of this log'} does not look along the floor")
    if others and wishes.mount is None:
        warnings.append(
            f"the laser has {len(mounts)} places: the most frequent is taken, --mount tells another"
        )
    readings = list(_readings(objects, label, changed))
    try:
        ordered = in_stamp_order(readings, changed, skipped, wishes)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    notes.append(f"scans from {label or 'the laser'}")
    messages = as_messages(ordered, (x, y, theta), wishes)
    return ImportedLog("MRPT", messages, skipped, changed, ignored, notes=notes, warnings=warnings)


def _unpacked(path: Path, skipped: Counter[str]) -> bytes:
    parts, size = [], 0
    with open_text(path) as file:
        while size <= _SIZE_LIMIT:
            try:
                part = file.read(1 << 20)
            except (EOFError, zlib.error, gzip.BadGzipFile):
                skipped["rest of the file: gzip data is damaged or cut off"] += 1
                break
            except OSError as error:
                raise LogError(f"{path}: cannot be read: {error.strerror}") from error
            if not part:
                break
            parts.append(part)
            size += len(part)
    if size > _SIZE_LIMIT:
        raise LogError(f"{path}: unpacks to more than 1 GB: cut it with `rawlog-edit --cut`")
    return b"".join(parts)


def _objects(data: bytes, skipped: Counter[str]) -> Iterator[Scan | Wheels | Moved]:
    """Yield what is known, in file order."""
    at = 0
    while header := _HEADER.search(data, at):
        name = header.group()[1:]
        at = header.end()
        if data[header.start()] & 0x7F != len(name):
            continue
        found = read_object(name.rpartition(b":")[2].decode(), data, at)
        if found is None:
            skipped[f"{name.decode()} of a version or form that is not known"] += 1
        else:
            thing, at = found
            yield thing


def _chosen(
    path: Path,
    objects: list[Scan | Wheels | Moved],
    wishes: Wishes,
    ignored: Counter[str],
    warnings: list[str],
) -> str:
    """Return the label of the laser to read: the one asked for, or that with the most scans."""
    counts = Counter(thing.label for thing in objects if isinstance(thing, Scan))
    if not counts:
        raise LogError(f"{path}: is a rawlog of MRPT without a 2D scan that can be read")
    if wishes.scan and wishes.scan not in counts:
        raise LogError(
            f"{path}: no laser {wishes.scan} for --scan (there are: {', '.join(counts)})"
        )
    label = wishes.scan or counts.most_common(1)[0][0]
    for other, count in counts.items():
        if other != label:
            ignored[f"{other or 'unnamed'} (another laser)"] += count
    if len(counts) > 1 and not wishes.scan:
        names = ", ".join(other or "unnamed" for other in counts if other != label)
        warnings.append(f"several lasers: {label} is taken, --scan takes another ({names})")
    return label


def _readings(
    objects: list[Scan | Wheels | Moved], label: str, changed: Counter[str]
) -> Iterator[Reading]:
    """Scans of one laser and the odometry; steps of a frame end where its scan was taken."""
    absolute = any(isinstance(thing, Wheels) for thing in objects)
    x = y = theta = 0.0
    stepped = False
    for thing in objects:
        if isinstance(thing, Wheels):
            yield Reading(WheelOdometry(thing.stamp_ns, thing.x, thing.y, thing.theta))
        elif isinstance(thing, Moved) and not absolute:
            c, s = math.cos(theta), math.sin(theta)
            x, y = x + c * thing.x - s * thing.y, y + s * thing.x + c * thing.y
            theta = math.remainder(theta + thing.theta, math.tau)
            stepped = True
        elif isinstance(thing, Scan) and thing.label == label:
            odometry = WheelOdometry(thing.stamp_ns, x, y, theta) if stepped else None
            yield Reading(odometry, _scan(thing))


def _scan(seen: Scan) -> LaserScan:
    """Bearings spread over the view; from the right where the laser says so, or hangs."""
    n = len(seen.ranges)
    step = seen.view_rad / max(n - 1, 1)
    side = 1.0 if seen.right_to_left == (seen.mount[3] > 0.0) else -1.0
    ranges = np.where(seen.valid, seen.ranges, np.float32(np.inf)).astype(np.float32)
    return LaserScan(
        seen.stamp_ns, -side * seen.view_rad / 2.0, side * step, ranges, range_max=seen.range_max
    )
