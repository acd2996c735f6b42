"""Small ROS recordings for tests: lists of messages with topic, kind and receipt, and files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000_000_000_000
STEP = 100_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
STORE1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TF, ECHOES = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/MultiEchoLaserScan"

Item = tuple[str, str, int, Any]  # topic, kind, time of receipt, message


class Maker:
    """Makes messages of ROS 2, or of ROS 1."""

    def __init__(self, ros1: bool = False) -> None:
        self.store = STORE1 if ros1 else STORE
        self.types = self.store.types
        self._ros1 = ros1

    def header(self, stamp_ns: int, frame: str) -> Any:
        when = self.types["builtin_interfaces/msg/Time"](
            sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
        )
        more = {"seq": 0} if self._ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=when, frame_id=frame, **more)

    def scan(
        self, stamp_ns: int, ranges: Sequence[float], frame: str = "laser", **given: Any
    ) -> Any:
        n = len(ranges)
        start = given.pop("angle_min", -math.pi / 2)
        step = given.pop("angle_increment", math.pi / n)
        fields = {
            "angle_max": start + step * (n - 1), "time_increment": 0.0, "scan_time": 0.1,
            "range_min": 0.1, "range_max": 30.0, "intensities": np.zeros(0, np.float32),
        } | given  # fmt: skip
        return self.types[SCAN](
            header=self.header(stamp_ns, frame), angle_min=start, angle_increment=step,
            ranges=np.asarray(ranges, np.float32), **fields,
        )  # fmt: skip

    def echoes(self, stamp_ns: int, beams: Sequence[Sequence[float]], frame: str = "laser") -> Any:
        echo = self.types["sensor_msgs/msg/LaserEcho"]
        n = len(beams)
        return self.types[ECHOES](
            header=self.header(stamp_ns, frame), angle_min=-1.0, angle_max=1.0,
            angle_increment=2.0 / (n - 1), time_increment=0.0, scan_time=0.1, range_min=0.1,
            range_max=30.0, ranges=[echo(echoes=np.asarray(b, np.float32)) for b in beams],
            intensities=[],
        )  # fmt: skip

    def quaternion(self, yaw: float, roll: float = 0.0) -> Any:
        cr, sr, cy, sy = (
            math.cos(roll / 2),
            math.sin(roll / 2),
            math.cos(yaw / 2),
            math.sin(yaw / 2),
        )
        return self.types["geometry_msgs/msg/Quaternion"](
            x=sr * cy, y=sr * sy, z=cr * sy, w=cr * cy
        )

    def odometry(
        self, stamp_ns: int, x: float, y: float = 0.0, yaw: float = 0.0,
        frame: str = "odom", child: str = "base_link", rotation: Any = None,
    ) -> Any:  # fmt: skip
        types = self.types
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
            orientation=rotation or self.quaternion(yaw),
        )
        return types[ODOMETRY](
            header=self.header(stamp_ns, frame), child_frame_id=child,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )  # fmt: skip

    def tf(
        self, stamp_ns: int, parent: str, child: str,
        x: float = 0.0, y: float = 0.0, yaw: float = 0.0, roll: float = 0.0,
    ) -> Any:  # fmt: skip
        types = self.types
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header=self.header(stamp_ns, parent), child_frame_id=child,
            transform=types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0),
                rotation=self.quaternion(yaw, roll),
            ),
        )  # fmt: skip
        return types[TF](transforms=[stamped])


ROS2 = Maker()


def room(n: int = 180) -> np.ndarray:
    """Ranges (n,) in a square room, half a turn from -90 degrees on (m)."""
    bearings = -math.pi / 2 + np.arange(n) * math.pi / n
    return 3.0 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings)))


def drive(
    n: int = 20, *, make: Maker = ROS2, scan: str = "/scan", odom: str = "/odom",
    tf: str = "/tf_static", laser: str = "laser", child: str = "base_link", frame: str = "odom",
    mount: tuple[float, float, float] | None = (0.2, 0.0, 0.3), start_x: float = 0.0,
    scan_delay_ns: int = 0, odom_delay_ns: int = 0,
) -> list[Item]:  # fmt: skip
    """A drive along x: n scans and n odometry messages at 10 Hz, x = 0, 0.1, ..."""
    items: list[Item] = []
    if mount is not None:
        items.append((tf, TF, START, make.tf(START, child, laser, *mount)))
    ranges = room()
    for k in range(n):
        stamp = START + k * STEP
        if odom:
            items.append((
                odom, ODOMETRY, stamp + 1000 + odom_delay_ns,
                make.odometry(stamp, start_x + 0.1 * k, frame=frame, child=child),
            ))  # fmt: skip
        items.append((scan, SCAN, stamp + 2000 + scan_delay_ns, make.scan(stamp, ranges, laser)))
    return items


def write_bag2(path: Path, items: Iterable[Item], sqlite: bool = False, version: int = 8) -> Path:
    """Write a ROS 2 bag with rosbags."""
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    with Writer(path, version=version, storage_plugin=plugin) as writer:
        known: dict[tuple[str, str], Any] = {}
        for topic, kind, receipt, message in items:
            key = topic, kind
            if key not in known:
                known[key] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[key], receipt, STORE.serialize_cdr(message, kind))
    return path


def write_bag1(path: Path, items: Iterable[Item], compression: str = "") -> Path:
    """Write a ROS 1 bag with rosbags; messages must be those of `Maker(ros1=True)`."""
    writer = Writer1(path)
    if compression:
        writer.set_compression(Writer1.CompressionFormat[compression])
    with writer:
        known: dict[str, Any] = {}
        for topic, kind, receipt, message in items:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE1)
            writer.write(known[topic], receipt, STORE1.serialize_ros1(message, kind))
    return path


def write_mcap(
    path: Path, items: Iterable[Item], *, profile: str = "ros2", ros1: bool = False,
    schemas: dict[str, tuple[str, bytes]] | None = None,
    foreign: Sequence[tuple[str, str, bytes]] = (), **options: Any,
) -> Path:  # fmt: skip
    """Write an MCAP file; `schemas` gives encoding and text by topic, else the true ones.

    `foreign` are further channels: topic, schema encoding, schema.
    """
    store = STORE1 if ros1 else STORE
    with path.open("wb") as stream:
        options.setdefault("compression", CompressionType.ZSTD)
        writer = McapWriter(stream, **options)
        writer.start(profile=profile, library="a test")
        for topic, encoding, text in foreign:
            schema = writer.register_schema(f"x{topic}", encoding, text)
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, START, b"{}", START)
        known: dict[tuple[str, str], int] = {}
        for topic, kind, receipt, message in items:
            key = topic, kind
            if key not in known:
                text = store.generate_msgdef(kind, ros_version=1 if ros1 else 2)[0].encode()
                encoding = "ros1msg" if ros1 else "ros2msg"
                encoding, text = (schemas or {}).get(topic, (encoding, text))
                name = kind.replace("/msg/", "/") if ros1 else kind
                schema = writer.register_schema(name, encoding, text)
                known[key] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
            data = (
                store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
            )
            writer.add_message(known[key], receipt, bytes(data), receipt)
        writer.finish()
    return path
