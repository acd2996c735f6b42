"""What a ROS recording holds: one pass that keeps stamps and poses, but no scan."""

from __future__ import annotations

import zlib
from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import shown
from slam.logs.importers.bag.channels import Account, Channel
from slam.logs.importers.bag.decode import Decoder, MalformedError
from slam.logs.importers.bag.files import Bag
from slam.logs.importers.bag.frames import FrameTree
from slam.logs.importers.bag.names import plain
from slam.logs.importers.bag.transforms import stamp_of, yaw_of
from slam.logs.schemas import STAMP_LIMIT

SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
SCANS = (SCAN, MULTI_ECHO)
READ = {*SCANS, ODOMETRY, *TRANSFORMS}

BEAMS_LIMIT = 100_000
FARTHEST_M = 1e8
"""Odometry beyond this is garbage: even coordinates counted from the equator stay below."""

_FRAMES_KEPT = 64  # names of frames on one topic


@dataclass(slots=True)
class Stream:
    """The messages of one topic and type, without what they measured unless that is a pose."""

    topic: str
    kind: str
    frames: Counter[str] = field(default_factory=Counter)  # of the headers
    children: Counter[str] = field(default_factory=Counter)  # child_frame_id of odometry
    stamps: array[int] = field(default_factory=lambda: array("q"))
    receipts: array[int] = field(default_factory=lambda: array("q"))
    frame_numbers: array[int] = field(default_factory=lambda: array("H"))  # places in `frames`
    poses: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta of odometry
    flaws: dict[int, str] = field(default_factory=dict)  # messages that cannot be used, and why
    digests: array[int] = field(default_factory=lambda: array("L"))  # of what scans measured
    turned: int = 0  # scans whose increment contradicts their end angle

    @property
    def count(self) -> int:
        """Messages, usable or not."""
        return len(self.stamps)

    @property
    def frame(self) -> str:
        """The frame of most messages."""
        return self.frames.most_common(1)[0][0] if self.frames else ""

    @property
    def child(self) -> str:
        """The child frame of most messages."""
        return self.children.most_common(1)[0][0] if self.children else ""

    def add(self, header: Any, receipt_ns: int, flaw: str) -> None:
        """Take in what all kinds have."""
        frame = plain(header.frame_id)
        if frame in self.frames or len(self.frames) < _FRAMES_KEPT:
            self.frames[frame] += 1
        stamp = stamp_of(header.stamp)
        if not flaw and not 0 <= stamp < STAMP_LIMIT:
            flaw = "message without a time"
        if flaw:
            self.flaws[self.count] = flaw
        self.stamps.append(min(max(stamp, 0), STAMP_LIMIT - 1))
        self.receipts.append(min(max(receipt_ns, 0), STAMP_LIMIT - 1))
        names = list(self.frames)
        self.frame_numbers.append(names.index(frame) if frame in names else _FRAMES_KEPT)

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return stamps and times of receipt, (n,) each."""
        return np.array(self.stamps, dtype=np.int64), np.array(self.receipts, dtype=np.int64)


@dataclass(slots=True)
class Inventory:
    """Everything that a choice is made from."""

    counts: Counter[Channel] = field(default_factory=Counter)
    streams: dict[tuple[str, str], Stream] = field(default_factory=dict)  # by topic and kind
    tree: FrameTree = field(default_factory=FrameTree)
    skipped: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
    first_ns: int = 0  # receipt
    last_ns: int = 0

    def of(self, *kinds: str) -> list[Stream]:
        """Return the streams of some kinds, by topic."""
        return [s for _, s in sorted(self.streams.items()) if s.kind in kinds and s.count]


def is_static(topic: str) -> bool:
    """Whether transforms on a topic hold for good."""
    return topic.rstrip("/").endswith("tf_static")


def take_inventory(bag: Bag, decode: Decoder) -> Inventory:
    """Go through a recording once.

    Raises:
        LogError: it cannot be read at all.
    """
    found, account = Inventory(), Account()
    for channel, receipt_ns, data in bag.messages(is_read, account):
        if not found.first_ns:
            found.first_ns = receipt_ns
        found.last_ns = max(found.last_ns, receipt_ns)
        try:
            message = decode(channel, data)
        except MalformedError:
            account.skipped[f"{shown(channel.topic)}: malformed message"] += 1
            continue
        if channel.kind in TRANSFORMS:
            for transform in message.transforms:
                found.tree.add(transform, is_static(channel.topic), receipt_ns)
            continue
        key = (channel.topic, channel.kind)
        if key not in found.streams:
            found.streams[key] = Stream(*key)
        if channel.kind == ODOMETRY:
            _add_odometry(found.streams[key], message, receipt_ns)
        else:
            _add_scan(found.streams[key], message, receipt_ns)
    found.counts, found.skipped, found.changed = account.counts, account.skipped, account.changed
    return found


def is_read(channel: Channel) -> bool:
    """Whether messages of a channel are looked into."""
    return channel.kind in READ and channel.is_ros


def _add_scan(stream: Stream, message: Any, receipt_ns: int) -> None:
    flaw = ""
    if not 0 < len(message.ranges) <= BEAMS_LIMIT:
        flaw = "scan without beams"
    elif not (
        np.isfinite((message.angle_min, message.angle_increment)).all() and message.angle_increment
    ):
        flaw = "scan without angles"
    elif is_turned(message):
        stream.turned += 1
    stream.add(message.header, receipt_ns, flaw)
    plain_ranges = isinstance(message.ranges, np.ndarray)
    stream.digests.append(zlib.crc32(message.ranges.tobytes()) if plain_ranges else stream.count)


def is_turned(message: Any) -> bool:
    """Whether a scan's increment has the wrong sign: with the other one it ends at `angle_max`."""
    start, end, step = message.angle_min, message.angle_max, message.angle_increment
    reach = step * (len(message.ranges) - 1)
    if not np.isfinite(end) or abs(reach) < 1e-3:
        return False
    within = max(2 * abs(step), 0.02)  # some drivers count one beam too many or too few
    return bool(abs(start - reach - end) <= within < abs(start + reach - end))


def _add_odometry(stream: Stream, message: Any, receipt_ns: int) -> None:
    child = plain(message.child_frame_id)
    if child in stream.children or len(stream.children) < _FRAMES_KEPT:
        stream.children[child] += 1
    pose = message.pose.pose
    x, y, theta = pose.position.x, pose.position.y, yaw_of(pose.orientation)
    flaw = ""
    if not np.isfinite((x, y)).all():
        flaw = "odometry without a finite pose"
    elif max(abs(x), abs(y)) > FARTHEST_M:
        flaw = "odometry where no robot can have driven"
    elif not np.isfinite(theta):
        flaw = "odometry without a heading (its quaternion is zero)"
    stream.add(message.header, receipt_ns, flaw)
    stream.poses.extend((0.0, 0.0, 0.0) if flaw else (x, y, theta))
