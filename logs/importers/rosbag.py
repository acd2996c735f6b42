"""ROS 1 bags and ROS 2 bags (MCAP or sqlite): LaserScan, Odometry, and the laser's mount.

Rules for what a bag leaves open:

- of several lasers one is read: the topic asked for, else `/scan`, else the one with most
  messages; the others are counted as ignored.  Odometry likewise (`/odom`);
- stamps are those of the headers; the bag's own time is the time of receipt;
- the mount is the chain of transforms from base_link (base_footprint, base) to the scan's
  frame; a laser that hangs upside down has its beams mirrored; without transforms the
  laser is taken to sit on the base, and that is counted;
- a bag is read twice, for the order of its stamps and for its messages, and never held;
- ranges follow REP 117: inf is "nothing came back", also from `range_max` on; -inf (too
  near), nan, and readings nearer than `range_min` become nan.
"""

from __future__ import annotations

import heapq
import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError, missing_extra, shown
from slam.logs.importers.imported import StreamedLog
from slam.logs.importers.ros_frames import TILT_RAD, FrameTree, Mount, plain, yaw_of
from slam.logs.importers.ros_messages import mirrored, scan_of, stamp_of
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, WheelOdometry
from slam.logs.schemas import STAMP_LIMIT

_SCAN = "sensor_msgs/msg/LaserScan"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TF = "tf2_msgs/msg/TFMessage"
_TF_OLD = "tf/msg/tfMessage"
BEAMS_LIMIT = 100_000

_Stamped = WheelOdometry | LaserScan


def read_rosbag(
    path: Path | str, *, scan_topic: str = "", odometry_topic: str = "", base_frame: str = ""
) -> StreamedLog:
    """Look through a bag; its messages are then read in stamp order, however large it is.

    `path` is a .bag, .mcap or .db3 file or a folder.

    Raises:
        LogError: if it cannot be read, holds no usable scan, or rosbags is not installed.
    """
    path = Path(path)
    bag = _Bag(path, scan_topic, odometry_topic)
    survey = _Survey()
    for receipt_ns, message in bag.readings(survey):
        survey.note(receipt_ns, message)
    if not survey.scans:
        raise LogError(f"{path}: {_nothing_found(survey, scan_topic)}")
    extrinsics = survey.extrinsics(base_frame)
    order = survey.order()

    def read() -> Iterator[tuple[SensorMessage, int]]:
        return _placed(bag.readings(_Survey()), order, extrinsics)

    return StreamedLog("ROS bag", read, survey.skipped, survey.changed, survey.ignored)


def _open(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise LogError(missing_extra(f"{path}: reading ROS bags", "ros")) from error
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except (AnyReaderError, *_BAG_ERRORS) as error:
        raise LogError(f"{path}: cannot be read as a ROS bag: {shown(str(error))}") from error
    return reader


# What rosbags lets through beside its own error when a bag is damaged.
_BAG_ERRORS = (
    *(OSError, ValueError, LookupError, AssertionError, TypeError, EOFError),
    *(struct.error, sqlite3.Error, OverflowError, MemoryError),
)


def _choose(reader: Any, kind: str, asked: str, usual: str) -> str:
    """Return the topic to read, empty if there is none of its kind."""
    counts: Counter[str] = Counter()
    for connection in reader.connections:
        if connection.msgtype == kind:
            counts[connection.topic] += connection.msgcount
    if asked or not counts:
        return asked if asked in counts else ""
    return usual if counts.get(usual) else min(counts, key=lambda topic: (-counts[topic], topic))


def _nothing_found(survey: _Survey, asked: str) -> str:
    if asked:
        return f"holds no LaserScan on {shown(asked)}: name another topic"
    if survey.skipped:
        cause, count = survey.skipped.most_common(1)[0]
        return f"no usable scan: {count} x {cause}"
    return "holds no sensor_msgs/LaserScan"


def _placed(
    readings: Iterator[tuple[int, _Stamped]], ranks: NDArray[np.int64], extrinsics: Mount
) -> Iterator[tuple[SensorMessage, int]]:
    """Yield the mount, then the readings by rank; only those that came too early are held."""
    waiting: list[tuple[int, int, _Stamped]] = []  # a heap: rank, time of receipt, message
    emitted = 0
    for rank, (receipt_ns, message) in zip(ranks.tolist(), readings, strict=True):
        heapq.heappush(waiting, (rank, receipt_ns, message))
        while waiting and waiting[0][0] == emitted:
            _, receipt, ready = heapq.heappop(waiting)
            if emitted == 0:
                yield (
                    LaserExtrinsics(ready.stamp_ns, extrinsics.x, extrinsics.y, extrinsics.theta),
                    receipt,
                )
            if isinstance(ready, LaserScan) and extrinsics.upside_down:
                ready = mirrored(ready)
            yield ready, receipt
            emitted += 1


class _Survey:
    """What must be known of a whole bag before its first message can be written."""

    def __init__(self) -> None:
        self.skipped: Counter[str] = Counter()
        self.changed: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self.frames = FrameTree()
        self.laser = ""  # frame of the scans
        self.scans = 0
        self._stamps = array("q")
        self._is_scan = bytearray()

    def note(self, receipt_ns: int, message: _Stamped) -> None:
        """Take in one reading."""
        is_scan = isinstance(message, LaserScan)
        self.scans += is_scan
        self._stamps.append(message.stamp_ns)
        self._is_scan.append(is_scan)

    def extrinsics(self, base_frame: str) -> Mount:
        """Where the laser sits, by the bag's transforms."""
        extrinsics = self.frames.extrinsics(self.laser, base_frame)
        if extrinsics is None:
            extrinsics = Mount(0.0, 0.0, 0.0, False, 0.0)
            self.changed["no transform from the base to the laser, taken to be none"] += 1
        if extrinsics.tilt > TILT_RAD:
            self.changed["the laser is tilted, its scans are taken as level"] += 1
        if self.scans == len(self._stamps):
            self.changed["no odometry in the bag"] += 1
        return extrinsics

    def order(self) -> NDArray[np.int64]:
        """The place of each reading, (n,), by stamp, odometry before a scan; oddities counted."""
        stamps = np.frombuffer(self._stamps, dtype=np.int64)
        is_scan = np.frombuffer(self._is_scan, dtype=np.uint8)
        for kind in (0, 1):
            own = stamps[is_scan == kind]
            if backwards := int(np.count_nonzero(np.diff(own) < 0)):
                self.changed["stamps that ran backwards, put in order"] += backwards
            if kind and (again := len(own) - len(np.unique(own))):
                self.changed["scans with the stamp of another, kept"] += again
        ranks = np.empty(len(stamps), dtype=np.int64)
        ranks[np.lexsort((is_scan, stamps))] = np.arange(len(stamps))
        return ranks


class _Bag:
    """A bag that can be read again and again."""

    def __init__(self, path: Path, scan_topic: str, odometry_topic: str) -> None:
        self._path, self._asked = path, (scan_topic, odometry_topic)

    def readings(self, survey: _Survey) -> Iterator[tuple[int, _Stamped]]:
        """Yield time of receipt and message in the bag's order; the rest goes to the survey.

        Raises:
            LogError: if the bag cannot be read at all.
        """
        with closing(_open(self._path)) as reader:
            scan_topic = _choose(reader, _SCAN, self._asked[0], "/scan")
            odometry_topic = _choose(reader, _ODOMETRY, self._asked[1], "/odom")
            wanted = _wanted(reader, scan_topic, odometry_topic, survey)
            for kind, receipt_ns, message in _messages(reader, wanted, survey):
                if kind == _SCAN:
                    reading: _Stamped | None = _scan(message, survey)
                elif kind == _ODOMETRY:
                    reading = _odometry(message, survey)
                else:
                    reading = None
                    for transform in message.transforms:
                        survey.frames.add(transform)
                if reading is not None:
                    yield receipt_ns, reading


def _wanted(reader: Any, scan_topic: str, odometry_topic: str, survey: _Survey) -> list[Any]:
    """Return the connections of use and count the messages of the others."""
    wanted = []
    for connection in reader.connections:
        ours = connection.topic in (scan_topic, odometry_topic)
        if connection.msgtype in (_TF, _TF_OLD) or (
            ours and connection.msgtype in (_SCAN, _ODOMETRY)
        ):
            wanted.append(connection)
        elif connection.msgcount:
            kind = "another laser" if connection.msgtype == _SCAN else connection.msgtype
            survey.ignored[f"{shown(connection.topic)} ({shown(kind)})"] += connection.msgcount
    return wanted


def _messages(reader: Any, wanted: list[Any], survey: _Survey) -> Iterator[tuple[str, int, Any]]:
    """Yield kind, time of receipt and message; damage is counted, not raised."""
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Reader1Error
    from rosbags.rosbag2 import ReaderError as Reader2Error
    from rosbags.serde import SerdeError

    if not wanted:
        return
    records = reader.messages(connections=wanted)
    while True:
        try:
            connection, receipt_ns, data = next(records)
        except StopIteration:
            return
        except (AnyReaderError, Reader1Error, Reader2Error, *_BAG_ERRORS):
            survey.skipped["rest of the bag: it is damaged or cut off"] += 1
            return
        try:
            message = reader.deserialize(data, connection.msgtype)
        except (AnyReaderError, SerdeError, *_BAG_ERRORS):
            survey.skipped[f"{shown(connection.topic)}: malformed message"] += 1
            continue
        yield connection.msgtype, receipt_ns, message


def _scan(message: Any, survey: _Survey) -> LaserScan | None:
    stamp_ns = stamp_of(message.header.stamp)
    n = len(message.ranges)
    geometry = (message.angle_min, message.angle_increment)
    if not 0 <= stamp_ns < STAMP_LIMIT or not 0 < n <= BEAMS_LIMIT:
        survey.skipped["scan without beams or time"] += 1
        return None
    if not (np.isfinite(geometry).all() and message.angle_increment):
        survey.skipped["scan without angles"] += 1
        return None
    survey.laser = survey.laser or message.header.frame_id
    if plain(message.header.frame_id) != plain(survey.laser):
        survey.skipped["scan of another frame on the same topic"] += 1
        return None
    return scan_of(message)


def _odometry(message: Any, survey: _Survey) -> WheelOdometry | None:
    stamp_ns, pose = stamp_of(message.header.stamp), message.pose.pose
    x, y, theta = pose.position.x, pose.position.y, yaw_of(pose.orientation)
    if not 0 <= stamp_ns < STAMP_LIMIT or not np.isfinite((x, y, theta)).all():
        survey.skipped["odometry without a finite pose or time"] += 1
        return None
    return WheelOdometry(stamp_ns, x, y, theta)
