"""Scans, poses, mounts and maps as Foxglove messages with our exact details beside them.

A quaternion cannot give a heading back to the last bit, nor can start and end angle give
the step, so decoding prefers the detail and falls back on Foxglove's own fields: a scan
from another program's log is read as well.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from slam.logs.messages import (
    FrameTransform,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    OccupancyMap,
    PoseEstimate,
    TruePose,
    WheelOdometry,
)
from slam.logs.protos import CLASSES

_Scan = CLASSES["LaserScan"]
_Odometry = CLASSES["Odometry"]
_Transform = CLASSES["FrameTransform"]
_Grid = CLASSES["Grid"]
_Log = CLASSES["Log"]

_PLANAR = tuple(6 * row + column for row in (0, 1, 5) for column in (0, 1, 5))
"""Where the covariance of (x, y, theta) sits in the 6x6 one of x, y, z and three rotations."""

_LEVELS: tuple[Literal["debug", "info", "warning", "error", "fatal"], ...] = (
    "debug", "info", "warning", "error", "fatal",
)  # fmt: skip
"""foxglove.Log.Level from 1 on; 0 is UNKNOWN."""

_INT8 = 2  # foxglove.PackedElementField.NumericType


def encode_scan(scan: LaserScan) -> bytes:
    """Encode a scan; ranges travel as doubles because Foxglove's schema says so."""
    out = _Scan(
        frame_id="laser",
        start_angle=scan.angle_min,
        end_angle=scan.angle_min + scan.angle_step * max(len(scan.ranges) - 1, 0),
        ranges=scan.ranges.astype("<f8").tobytes(),
    )
    _set_time(out.timestamp, scan.stamp_ns)
    out.pose.orientation.w = 1.0
    out.slam.angle_step = scan.angle_step
    out.slam.range_min = scan.range_min
    out.slam.range_max = scan.range_max
    out.slam.beam_period_s = scan.beam_period_s
    payload: bytes = out.SerializeToString()
    return payload


def decode_scan(stamp_ns: int, data: bytes) -> LaserScan:
    """Decode a scan; one without our detail gets its step from the end angle."""
    read = _Scan.FromString(data)
    if len(read.ranges) % 8:
        raise ValueError("ranges are not whole numbers")
    with np.errstate(over="ignore", invalid="ignore"):  # inf and nan are readings like others
        ranges = np.frombuffer(read.ranges, dtype="<f8").astype(np.float32)
    start: float = read.start_angle
    if not read.HasField("slam"):
        return LaserScan(
            stamp_ns, start, (read.end_angle - start) / max(len(ranges) - 1, 1), ranges
        )
    detail = read.slam
    return LaserScan(
        stamp_ns,
        start,
        detail.angle_step,
        ranges,
        detail.range_min,
        detail.range_max,
        detail.beam_period_s,
    )


def _encode_planar(pose: Any, stamp_ns: int, frame: str, body: str) -> Any:
    out = _Odometry(frame_id=frame, body_frame_id=body)
    _set_time(out.timestamp, stamp_ns)
    out.pose.position.x, out.pose.position.y = pose.x, pose.y
    _set_heading(out.pose.orientation, pose.theta)
    out.slam.theta = pose.theta
    return out


def _decode_planar(data: bytes) -> tuple[Any, tuple[float, float, float]]:
    read = _Odometry.FromString(data)
    theta = read.slam.theta if read.HasField("slam") else _heading(read.pose.orientation)
    return read, (read.pose.position.x, read.pose.position.y, theta)


def encode_odometry(message: WheelOdometry) -> bytes:
    """Encode `odom_T_base`."""
    payload: bytes = _encode_planar(message, message.stamp_ns, "odom", "base").SerializeToString()
    return payload


def decode_odometry(stamp_ns: int, data: bytes) -> WheelOdometry:
    """Decode `odom_T_base`."""
    return WheelOdometry(stamp_ns, *_decode_planar(data)[1])


def encode_truth(message: TruePose) -> bytes:
    """Encode `world_T_base`."""
    payload: bytes = _encode_planar(message, message.stamp_ns, "world", "base").SerializeToString()
    return payload


def decode_truth(stamp_ns: int, data: bytes) -> TruePose:
    """Decode `world_T_base`."""
    return TruePose(stamp_ns, *_decode_planar(data)[1])


def encode_pose(message: PoseEstimate) -> bytes:
    """Encode `map_T_base` with its covariance, 9 numbers or none."""
    out = _encode_planar(message, message.stamp_ns, "map", "base")
    out.slam.lost = message.lost
    if message.covariance:
        if len(message.covariance) != len(_PLANAR):
            raise ValueError(f"a covariance has 9 numbers, not {len(message.covariance)}")
        full = [0.0] * 36
        for place, value in zip(_PLANAR, message.covariance, strict=True):
            full[place] = value
        out.pose_covariance.extend(full)
    payload: bytes = out.SerializeToString()
    return payload


def decode_pose(stamp_ns: int, data: bytes) -> PoseEstimate:
    """Decode `map_T_base`."""
    read, pose = _decode_planar(data)
    full = read.pose_covariance
    if len(full) not in (0, 36):
        raise ValueError("the covariance is not 6 by 6")
    covariance = tuple(full[place] for place in _PLANAR) if full else ()
    return PoseEstimate(stamp_ns, *pose, covariance, read.slam.lost)


class ForViewersError(ValueError):
    """A transform that says nothing new: it is there for viewers, and readers pass over it."""


VIEWER_FRAMES = (("map", "odom"), ("odom", "base"), ("map", "world"))
"""Parent and child of the transforms that a RUN's log holds beside the mount."""


def encode_tf(message: LaserExtrinsics | FrameTransform) -> bytes:
    """Encode the mount, or a transform for viewers."""
    if isinstance(message, LaserExtrinsics):
        return encode_mount(message)
    pose = message.x, message.y, message.theta
    return encode_transform(message.stamp_ns, message.parent, message.child, *pose)


def encode_mount(message: LaserExtrinsics) -> bytes:
    """Encode `base_T_laser` as a transform of the tree that viewers keep."""
    return encode_transform(message.stamp_ns, "base", "laser", message.x, message.y, message.theta)


def encode_transform(
    stamp_ns: int, parent: str, child: str, x: float, y: float, theta: float
) -> bytes:
    """Encode `parent_T_child`."""
    out = _Transform(parent_frame_id=parent, child_frame_id=child)
    _set_time(out.timestamp, stamp_ns)
    out.translation.x, out.translation.y = x, y
    _set_heading(out.rotation, theta)
    out.slam.theta = theta
    payload: bytes = out.SerializeToString()
    return payload


def decode_mount(stamp_ns: int, data: bytes) -> LaserExtrinsics:
    """Decode `base_T_laser`; another program's transform between other frames is refused."""
    read = _Transform.FromString(data)
    frames = read.parent_frame_id, read.child_frame_id
    if frames in VIEWER_FRAMES:
        raise ForViewersError(f"{frames[0]} -> {frames[1]} is for viewers")
    if frames != ("base", "laser"):
        raise ValueError("a transform of other frames than base and laser")
    theta = read.slam.theta if read.HasField("slam") else _heading(read.rotation)
    return LaserExtrinsics(stamp_ns, read.translation.x, read.translation.y, theta)


def encode_map(message: OccupancyMap) -> bytes:
    """Encode a map, one signed byte a cell, row by row from the origin."""
    rows, columns = message.cells.shape
    out = _Grid(frame_id="map", column_count=columns, row_stride=columns, cell_stride=1)
    _set_time(out.timestamp, message.stamp_ns)
    out.pose.position.x, out.pose.position.y = message.origin_x, message.origin_y
    out.pose.orientation.w = 1.0
    out.cell_size.x = out.cell_size.y = message.resolution
    out.fields.add(name="occupancy", offset=0, type=_INT8)
    out.data = message.cells.astype(np.int8, copy=False).tobytes()
    out.slam.rows = rows
    payload: bytes = out.SerializeToString()
    return payload


def decode_map(stamp_ns: int, data: bytes) -> OccupancyMap:
    """Decode a map that this program wrote."""
    read = _Grid.FromString(data)
    rows, columns = read.slam.rows, read.column_count
    if rows < 0 or len(read.data) != rows * columns or read.row_stride != columns:
        raise ValueError("the cells do not fill the rows and columns")
    cells = np.frombuffer(read.data, dtype=np.int8).reshape(rows, columns)
    origin = read.pose.position
    return OccupancyMap(stamp_ns, read.cell_size.x, origin.x, origin.y, cells)


def encode_log(message: LogLine) -> bytes:
    """Encode a line of the log panel."""
    out = _Log(level=1 + _LEVELS.index(message.level), name=message.name, message=message.text)
    _set_time(out.timestamp, message.stamp_ns)
    payload: bytes = out.SerializeToString()
    return payload


def decode_log(stamp_ns: int, data: bytes) -> LogLine:
    """Decode a line; a program's file and line number are of no use here."""
    read = _Log.FromString(data)
    if not 1 <= read.level <= len(_LEVELS):
        raise ValueError("unknown level")
    return LogLine(stamp_ns, _LEVELS[read.level - 1], read.name, read.message)


def _set_time(timestamp: Any, stamp_ns: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(stamp_ns, 1_000_000_000)


def _set_heading(quaternion: Any, theta: float) -> None:
    if math.isfinite(theta):
        quaternion.z, quaternion.w = math.sin(theta / 2), math.cos(theta / 2)


def _heading(quaternion: Any) -> float:
    return 2.0 * math.atan2(quaternion.z, quaternion.w)
