"""ROS 1 bags and ROS 2 bags (MCAP or sqlite): LaserScan, Odometry, and the laser's mount.

Rules for what a bag leaves open:

- of several lasers one is read: the topic asked for, else `/scan`, else the one with most
  messages; the others are counted as ignored.  Odometry likewise (`/odom`);
- stamps are those of the headers; the bag's own time is the time of receipt;
- the mount is the chain of transforms from base_link (base_footprint, base) to the scan's
  frame; a laser that hangs upside down has its beams mirrored; without transforms the
  laser is taken to sit on the base, and that is counted;
- ranges follow REP 117: inf is "nothing came back", also from `range_max` on; -inf (too
  near), nan, and readings nearer than `range_min` become nan.
"""

from __future__ import annotations

import sqlite3
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError, shown
from logs.importers.imported import ImportedLog, ordered
from logs.importers.ros_frames import TILT_RAD, FrameTree, Mount, plain, yaw_of
from logs.importers.ros_messages import mirrored, scan_of, stamp_of
from logs.messages import LaserMount, LaserScan, WheelOdometry
from logs.schemas import STAMP_LIMIT

_SCAN = "sensor_msgs/msg/LaserScan"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TF = "tf2_msgs/msg/TFMessage"
_TF_OLD = "tf/msg/tfMessage"
BEAMS_LIMIT = 100_000


def read_rosbag(
    path: Path | str, *, scan_topic: str = "", odometry_topic: str = "", base_frame: str = ""
) -> ImportedLog:
    """Read a bag into messages in stamp order; `path` is a .bag, .mcap or .db3 file or a folder.

    Raises:
        LogError: if it cannot be read, holds no usable scan, or rosbags is not installed.
    """
    path = Path(path)
    with closing(_open(path)) as reader:
        bag = _Bag(reader, _choose(reader, _SCAN, scan_topic, "/scan"), base_frame)
        odometry = _choose(reader, _ODOMETRY, odometry_topic, "/odom")
        bag.read(path, odometry)
    if not bag.scans:
        raise LogError(f"{path}: {_nothing_found(bag, scan_topic)}")
    return bag.finish()


def _open(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise LogError(
            f"{path}: reading ROS bags needs rosbags: run `pip install 'sdp-slam[ros]'`"
        ) from error
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


def _nothing_found(bag: _Bag, asked: str) -> str:
    if asked:
        return f"holds no LaserScan on {shown(asked)}: name another topic"
    if bag.skipped:
        cause, count = bag.skipped.most_common(1)[0]
        return f"no usable scan: {count} x {cause}"
    return "holds no sensor_msgs/LaserScan"


class _Bag:
    """One pass over a bag."""

    def __init__(self, reader: Any, scan_topic: str, base_frame: str) -> None:
        self.scans: list[tuple[int, LaserScan]] = []  # time of receipt, message
        self.odometry: list[tuple[int, WheelOdometry]] = []
        self.skipped: Counter[str] = Counter()
        self.changed: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self._reader, self._scan_topic, self._base = reader, scan_topic, base_frame
        self._frames = FrameTree()
        self._laser = ""

    def read(self, path: Path, odometry_topic: str) -> None:
        """Read what is of use and count the rest."""
        wanted = []
        for connection in self._reader.connections:
            ours = connection.topic in (self._scan_topic, odometry_topic)
            if connection.msgtype in (_TF, _TF_OLD) or (
                ours and connection.msgtype in (_SCAN, _ODOMETRY)
            ):
                wanted.append(connection)
            elif connection.msgcount:
                kind = "another laser" if connection.msgtype == _SCAN else connection.msgtype
                self.ignored[f"{shown(connection.topic)} ({shown(kind)})"] += connection.msgcount
        if not wanted:
            return
        for kind, receipt_ns, message in self._messages(wanted):
            if kind == _SCAN:
                self._take_scan(receipt_ns, message)
            elif kind == _ODOMETRY:
                self._take_odometry(receipt_ns, message)
            else:
                for transform in message.transforms:
                    self._frames.add(transform)

    def _messages(self, wanted: list[Any]) -> Iterator[tuple[str, int, Any]]:
        """Yield kind, time of receipt and message; damage is counted, not raised."""
        from rosbags.highlevel import AnyReaderError
        from rosbags.rosbag1 import ReaderError as Reader1Error
        from rosbags.rosbag2 import ReaderError as Reader2Error
        from rosbags.serde import SerdeError

        records = self._reader.messages(connections=wanted)
        while True:
            try:
                connection, receipt_ns, data = next(records)
            except StopIteration:
                return
            except (AnyReaderError, Reader1Error, Reader2Error, *_BAG_ERRORS):
                self.skipped["rest of the bag: it is damaged or cut off"] += 1
                return
            try:
                message = self._reader.deserialize(data, connection.msgtype)
            except (AnyReaderError, SerdeError, *_BAG_ERRORS):
                self.skipped[f"{shown(connection.topic)}: malformed message"] += 1
                continue
            yield connection.msgtype, receipt_ns, message

    def _take_scan(self, receipt_ns: int, message: Any) -> None:
        stamp_ns = stamp_of(message.header.stamp)
        n = len(message.ranges)
        geometry = (message.angle_min, message.angle_increment)
        if not 0 <= stamp_ns < STAMP_LIMIT or not 0 < n <= BEAMS_LIMIT:
            self.skipped["scan without beams or time"] += 1
            return
        if not (np.isfinite(geometry).all() and message.angle_increment):
            self.skipped["scan without angles"] += 1
            return
        self._laser = self._laser or message.header.frame_id
        if plain(message.header.frame_id) != plain(self._laser):
            self.skipped["scan of another frame on the same topic"] += 1
            return
        self.scans.append((receipt_ns, scan_of(message)))

    def _take_odometry(self, receipt_ns: int, message: Any) -> None:
        stamp_ns, pose = stamp_of(message.header.stamp), message.pose.pose
        x, y, theta = pose.position.x, pose.position.y, yaw_of(pose.orientation)
        if not 0 <= stamp_ns < STAMP_LIMIT or not np.isfinite((x, y, theta)).all():
            self.skipped["odometry without a finite pose or time"] += 1
            return
        self.odometry.append((receipt_ns, WheelOdometry(stamp_ns, x, y, theta)))

    def finish(self) -> ImportedLog:
        """Place the laser and put everything in order."""
        mount = self._frames.mount(self._laser, self._base)
        if mount is None:
            mount = Mount(0.0, 0.0, 0.0, False, 0.0)
            self.changed["no transform from the base to the laser, taken to be none"] += 1
        if mount.tilt > TILT_RAD:
            self.changed["the laser is tilted, its scans are taken as level"] += 1
        scans = self.scans
        if mount.upside_down:
            scans = [(receipt, mirrored(scan)) for receipt, scan in scans]
        if not self.odometry:
            self.changed["no odometry in the bag"] += 1
        readings = ordered([*self.odometry, *scans], self.changed)
        first_receipt, first = readings[0]
        placed = LaserMount(first.stamp_ns, mount.x, mount.y, mount.theta)
        return ImportedLog(
            "ROS bag",
            [placed, *(message for _, message in readings)],
            self.skipped,
            self.changed,
            self.ignored,
            [first_receipt, *(receipt for receipt, _ in readings)],
        )
