"""Our messages as ROS 2 messages; `types` is the typestore's mapping from name to class."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from slam.logs.messages import (
    DeviceHealth,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    OccupancyMap,
    PoseEstimate,
    TruePose,
    WheelOdometry,
)

Types = Mapping[str, Any]
Pose = tuple[float, float, float]

_PLANAR = tuple(6 * row + column for row in (0, 1, 5) for column in (0, 1, 5))
_UNKNOWN = -1.0  # first element of a covariance that is not known, as for sensor_msgs/Imu


def time_of(types: Types, stamp_ns: int) -> Any:
    """Return a builtin_interfaces/Time; its seconds end in 2038 (int32)."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def header(types: Types, stamp_ns: int, frame: str) -> Any:
    """Return a std_msgs/Header."""
    return types["std_msgs/msg/Header"](stamp=time_of(types, stamp_ns), frame_id=frame)


def scan(types: Types, message: LaserScan, scan_period_s: float) -> Any:
    """Return a sensor_msgs/LaserScan; angles and times become single precision."""
    n = len(message.ranges)
    return types["sensor_msgs/msg/LaserScan"](
        header=header(types, message.stamp_ns, "laser"),
        angle_min=message.angle_min,
        angle_max=message.angle_min + message.angle_step * max(n - 1, 0),
        angle_increment=message.angle_step,
        time_increment=message.beam_period_s,
        scan_time=scan_period_s,
        range_min=message.range_min,
        range_max=message.range_max,
        ranges=np.ascontiguousarray(message.ranges, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def odometry(types: Types, message: WheelOdometry | TruePose) -> Any:
    """Return a nav_msgs/Odometry of `odom_T_base`, or `world_T_base` for the truth."""
    frame = "odom" if isinstance(message, WheelOdometry) else "world"
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    return types["nav_msgs/msg/Odometry"](
        header=header(types, message.stamp_ns, frame),
        child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(types, (message.x, message.y, message.theta)), covariance=np.zeros(36)
        ),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist, covariance=np.array([_UNKNOWN] + [0.0] * 35)
        ),
    )


def estimate(types: Types, message: PoseEstimate) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped.

    ROS means the covariance in the header's frame: ours, in the base frame, is turned.
    """
    full = np.zeros(36)
    if message.covariance:
        c, s = math.cos(message.theta), math.sin(message.theta)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        planar = turn @ np.reshape(message.covariance, (3, 3)) @ turn.T
        full[list(_PLANAR)] = planar.ravel()
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](
        header=header(types, message.stamp_ns, "map"),
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose(types, (message.x, message.y, message.theta)), covariance=full
        ),
    )


def path(types: Types, estimates: list[PoseEstimate]) -> Any:
    """Return a nav_msgs/Path of all estimates, stamped with the last."""
    stamped = types["geometry_msgs/msg/PoseStamped"]
    return types["nav_msgs/msg/Path"](
        header=header(types, estimates[-1].stamp_ns, "map"),
        poses=[
            stamped(header=header(types, e.stamp_ns, "map"), pose=pose(types, (e.x, e.y, e.theta)))
            for e in estimates
        ],
    )


def occupancy(types: Types, message: OccupancyMap) -> Any:
    """Return a nav_msgs/OccupancyGrid: the same cells, row by row from the origin."""
    rows, columns = message.cells.shape
    when = time_of(types, message.stamp_ns)
    return types["nav_msgs/msg/OccupancyGrid"](
        header=header(types, message.stamp_ns, "map"),
        info=types["nav_msgs/msg/MapMetaData"](
            map_load_time=when,
            resolution=message.resolution,
            width=columns,
            height=rows,
            origin=pose(types, (message.origin_x, message.origin_y, 0.0)),
        ),
        data=np.ascontiguousarray(message.cells, dtype=np.int8).ravel(),
    )


def transform(types: Types, stamp_ns: int, parent: str, child: str, at: Pose) -> Any:
    """Return a tf2_msgs/TFMessage of one transform."""
    x, y, theta = at
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=header(types, stamp_ns, parent),
        child_frame_id=child,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0),
            rotation=_quaternion(types, theta),
        ),
    )
    return types["tf2_msgs/msg/TFMessage"](transforms=[stamped])


def extrinsics(types: Types, message: LaserExtrinsics) -> Any:
    """Return the static transform of the laser."""
    at = (message.x, message.y, message.theta)
    return transform(types, message.stamp_ns, "base_link", "laser", at)


def log_line(types: Types, message: LogLine) -> Any:
    """Return an rcl_interfaces/Log; its levels are 10 for DEBUG to 50 for FATAL."""
    kind = types["rcl_interfaces/msg/Log"]
    levels = {
        "debug": kind.DEBUG, "info": kind.INFO, "warning": kind.WARN, "error": kind.ERROR,
        "fatal": kind.FATAL,
    }  # fmt: skip
    return kind(
        stamp=time_of(types, message.stamp_ns),
        level=levels[message.level],
        name=message.name,
        msg=message.text,
        file="",
        function="",
        line=0,
    )


def diagnostics(types: Types, message: DeviceHealth) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray of one device; lost or failed is an error."""
    kind, pair = (
        types["diagnostic_msgs/msg/DiagnosticStatus"],
        types["diagnostic_msgs/msg/KeyValue"],
    )
    status = kind(
        level=kind.ERROR if message.link in ("lost", "failed") else kind.OK,
        name=message.device,
        message=message.link,
        hardware_id=message.device,
        values=[
            pair(key=name, value=value)
            for name, value in zip(message.names, message.values, strict=True)
        ],
    )
    return types["diagnostic_msgs/msg/DiagnosticArray"](
        header=header(types, message.stamp_ns, ""), status=[status]
    )


def pose(types: Types, at: Pose) -> Any:
    """Return a geometry_msgs/Pose."""
    x, y, theta = at
    return types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0),
        orientation=_quaternion(types, theta),
    )


def _quaternion(types: Types, theta: float) -> Any:
    return types["geometry_msgs/msg/Quaternion"](
        x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2)
    )
