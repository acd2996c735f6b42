"""Messages as a ROS 2 bag: a folder with one MCAP file and its metadata.yaml.

| ours | topic | type |
| --- | --- | --- |
| LaserScan | /scan | sensor_msgs/LaserScan, frame `laser` |
| WheelOdometry | /odom, /tf | nav_msgs/Odometry, tf2_msgs/TFMessage `odom` -> `base_link` |
| LaserExtrinsics | /tf_static | tf2_msgs/TFMessage `base_link` -> `laser` |
| PoseEstimate | /pose, /tf | PoseWithCovarianceStamped, TFMessage `map` -> `odom` |
| all PoseEstimates | /path | nav_msgs/Path, once at the end |
| OccupancyMap | /map | nav_msgs/OccupancyGrid |
| TruePose | /truth, /tf_static | nav_msgs/Odometry, frame `world`; of a RUN `map` -> `world` |
| LogLine | /rosout | rcl_interfaces/Log |
| DeviceHealth | /diagnostics | diagnostic_msgs/DiagnosticArray |

Messages of other kinds have no standard in ROS and are left out, counted.  Static data is
offered as "transient local", so that `ros2 bag play` gives it to late subscribers as well.
"""

from __future__ import annotations

import math
import shutil
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from slam.logs.errors import LogError, missing_extra
from slam.logs.exporters import ros2_messages as ros
from slam.logs.messages import (
    DeviceHealth,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    Message,
    OccupancyMap,
    PoseEstimate,
    TruePose,
    WheelOdometry,
)
from slam.logs.schemas import topic_of

METADATA_VERSION: Literal[8] = 8
"""Of metadata.yaml: 9 writes QoS as a list with words, which Humble cannot read; all read 8."""

_STAMP_LIMIT = 2**31 * 10**9  # ROS 2 counts seconds in 32 bits
_STATIC = ("/tf_static", "/map", "/path")
_TYPES = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/odom": "nav_msgs/msg/Odometry",
    "/truth": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/path": "nav_msgs/msg/Path",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/rosout": "rcl_interfaces/msg/Log",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


@dataclass(frozen=True, slots=True)
class Ros2Export:
    """What was written."""

    path: Path  # of the bag's folder
    written: dict[str, int]  # messages per ROS topic
    skipped: dict[str, int] = field(default_factory=dict)  # per cause


def write_ros2(path: Path | str, received: Iterable[tuple[int | None, Message]]) -> Ros2Export:
    """Write a ROS 2 bag from messages with their times of receipt (None: the stamp).

    `Log.receipts()` has this form.  The folder appears under its name when it is complete.

    Raises:
        LogError: if the folder is there already or cannot be written, or rosbags is missing.
    """
    path = Path(path)
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise LogError(missing_extra(f"{path}: writing ROS bags", "ros")) from error
    if path.exists() or not path.parent.is_dir():
        reason = "is there already" if path.exists() else "its folder does not exist"
        raise LogError(f"{path}: {reason}: name a new folder for the bag")
    partial = path.with_name(path.name + ".partial")
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        with Writer(
            partial / path.name, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
        ) as writer:
            bag = _Bag(writer, store)
            for receipt_ns, message in received:
                bag.take(receipt_ns, message)
            bag.finish()
            if not bag.written:
                raise LogError(f"{path}: there is no message that ROS has a type for")
        (partial / path.name).rename(path)
    except OSError as error:
        raise LogError(f"{path}: writing failed: {error.strerror}") from error
    except WriterError as error:
        raise LogError(f"{path}: writing failed: {error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return Ros2Export(path, dict(bag.written), dict(bag.skipped))


class _Bag:
    """Converts messages one by one and keeps what later ones need."""

    def __init__(self, writer: Any, store: Any) -> None:
        self.written: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self._writer, self._store, self._types = writer, store, store.types
        self._connections: dict[str, Any] = {}
        self._odometry: WheelOdometry | None = None
        self._truth: TruePose | None = None
        self._estimates: list[PoseEstimate] = []
        self._last_scan_ns = self._last_receipt_ns = 0

    def take(self, receipt_ns: int | None, message: Message) -> None:
        """Write one message in its ROS form or forms."""
        receipt = message.stamp_ns if receipt_ns is None else receipt_ns
        if not 0 <= message.stamp_ns < _STAMP_LIMIT:
            self.skipped["stamp after the year 2038, which ROS 2 cannot hold"] += 1
            return
        self._last_receipt_ns = max(self._last_receipt_ns, receipt)
        types = self._types
        if isinstance(message, LaserScan):
            period_s = (message.stamp_ns - self._last_scan_ns) * 1e-9 if self._last_scan_ns else 0.0
            self._last_scan_ns = message.stamp_ns
            self._write("/scan", receipt, ros.scan(types, message, max(period_s, 0.0)))
        elif isinstance(message, WheelOdometry):
            self._odometry = message
            self._write("/odom", receipt, ros.odometry(types, message))
            at = (message.x, message.y, message.theta)
            step = ros.transform(types, message.stamp_ns, "odom", "base_link", at)
            self._write("/tf", receipt, step)
        elif isinstance(message, TruePose):
            self._truth = message
            self._write("/truth", receipt, ros.odometry(types, message))
        elif isinstance(message, LaserExtrinsics):
            self._write("/tf_static", receipt, ros.extrinsics(types, message))
        elif isinstance(message, PoseEstimate):
            self._take_estimate(receipt, message)
        elif isinstance(message, OccupancyMap):
            self._write("/map", receipt, ros.occupancy(types, message))
        elif isinstance(message, LogLine):
            self._write("/rosout", receipt, ros.log_line(types, message))
        elif isinstance(message, DeviceHealth):
            self._write("/diagnostics", receipt, ros.diagnostics(types, message))
        else:
            self.skipped[f"{topic_of(message)}: has no standard type in ROS"] += 1

    def _take_estimate(self, receipt: int, message: PoseEstimate) -> None:
        self._estimates.append(message)
        self._write("/pose", receipt, ros.estimate(self._types, message))
        if self._truth is not None and len(self._estimates) == 1:
            # Viewers put the truth into the map by this: it is laid on the first pose.
            at = _correction(message, self._truth)
            world = ros.transform(self._types, message.stamp_ns, "map", "world", at)
            self._write("/tf_static", receipt, world)
        if self._odometry is not None:
            at = _correction(message, self._odometry)
            correction = ros.transform(self._types, message.stamp_ns, "map", "odom", at)
            self._write("/tf", receipt, correction)

    def finish(self) -> None:
        """Write what can be said only at the end."""
        if self._estimates:
            self._write("/path", self._last_receipt_ns, ros.path(self._types, self._estimates))

    def _write(self, topic: str, receipt_ns: int, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, _TYPES[topic], typestore=self._store, offered_qos_profiles=[_qos(topic)]
            )
        data = self._store.serialize_cdr(message, _TYPES[topic])
        self._writer.write(self._connections[topic], receipt_ns, data)
        self.written[topic] += 1


def _correction(estimate: PoseEstimate, odometry: WheelOdometry | TruePose) -> ros.Pose:
    """Return map_T_base * inverse(odom_T_base), of the odometry (or truth) last seen."""
    theta = math.remainder(estimate.theta - odometry.theta, math.tau)
    c, s = math.cos(theta), math.sin(theta)
    x = estimate.x - (c * odometry.x - s * odometry.y)
    y = estimate.y - (s * odometry.x + c * odometry.y)
    return x, y, theta


def _qos(topic: str) -> Any:
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(sec=9223372036, nsec=854775807)
    static = topic in _STATIC
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if static else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if static else QosDurability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )
