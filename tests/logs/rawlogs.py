"""Rawlogs of MRPT, put together byte by byte."""

from __future__ import annotations

import gzip
import math
import struct
from collections.abc import Iterable
from pathlib import Path

from slam.logs.messages import LaserScan, WheelOdometry


def thing(name: str, version: int, fields: bytes, prefix: str = "") -> bytes:
    """An object: header, fields, end flag."""
    full = (prefix + name).encode()
    return bytes([0x80 | len(full)]) + full + bytes([version]) + fields + b"\x88"


def ticks(stamp_ns: int) -> bytes:
    return struct.pack("<Q", stamp_ns // 100 + 116_444_736_000_000_000)


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def pose2(x: float, y: float, theta: float) -> bytes:
    return thing("CPose2D", 1, struct.pack("<3d", x, y, theta))


def pose3(x: float, y: float, theta: float, roll: float = 0.0) -> bytes:
    cr, sr, cy, sy = (
        math.cos(roll / 2),
        math.sin(roll / 2),
        math.cos(theta / 2),
        math.sin(theta / 2),
    )
    return thing("CPose3D", 2, struct.pack("<7d", x, y, 0.3, cr * cy, sr * cy, sr * sy, cr * sy))


def scan(
    message: LaserScan, mount: tuple[float, float, float], version: int = 7, label: str = "LASER",
    prefix: str = "", roll: float = 0.0,
) -> bytes:  # fmt: skip
    """A scan as MRPT keeps it: its view lies evenly about the axis of the laser."""
    n = len(message.ranges)
    view = abs(message.angle_step) * (n - 1)
    leftward = message.angle_step > 0
    fields = struct.pack("<f?f", view, leftward != (roll != 0.0), message.range_max)
    fields += pose3(*mount, roll)
    if version < 6:
        fields += thing("CMatrix", 0, struct.pack("<II36f", 6, 6, *[0.0] * 36))
    valid = [math.isfinite(r) for r in message.ranges]
    kept = [float(r) if ok else 0.0 for r, ok in zip(message.ranges, valid, strict=True)]
    fields += struct.pack(f"<I{n}f{n}b", n, *kept, *valid) + struct.pack("<f", 0.01)
    fields += ticks(message.stamp_ns) + struct.pack("<f", 0.004)
    if version >= 5:
        fields += text(label) + struct.pack("<d", 0.0)
    if version >= 7:
        fields += b"\0"
    if version >= 8:
        fields += struct.pack("<f", 0.1)
    return thing("CObservation2DRangeScan", version, fields, prefix)


def wheels(message: WheelOdometry, version: int = 2, prefix: str = "") -> bytes:
    fields = pose2(message.x, message.y, message.theta) + text("ODO") + ticks(message.stamp_ns)
    if version == 1:
        fields += b"\0" + struct.pack("<ii", 0, 0) + b"\1" + struct.pack("<ff", 0.1, 0.0)
    elif version == 2:
        fields += b"\0\1" + struct.pack("<ddd", 0.1, 0.0, 0.0)
    return thing("CObservationOdometry", version, fields, prefix)


def moved(step: tuple[float, float, float]) -> bytes:
    """An action as of version 5 that holds odometry, in a collection."""
    fields = struct.pack("<I", 0) + pose2(*step) + struct.pack("<I6f", 0, *[0.1] * 6)
    fields += struct.pack("<I6f", 300, *[0.1] * 6) + b"\0" + bytes(8) + b"\0" + bytes(8)
    action = thing("CActionRobotMovement2D", 5, fields)
    return thing("CActionCollection", 0, struct.pack("<I", 1) + action)


def write(path: Path, things: Iterable[bytes], packed: bool = True) -> Path:
    data = b"".join(things)
    path.write_bytes(gzip.compress(data, 1) if packed else data)
    return path
