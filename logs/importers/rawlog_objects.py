"""The objects of MRPT's serialisation that hold scans and odometry."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_END = 0x88
_1601_TO_1970 = 116_444_736_000_000_000  # MRPT counts units of 100 ns since 1601
_BEAMS_LIMIT = 100_000
_LABEL_LIMIT = 1000
_BY_ODOMETRY = 0  # estimation method: the step is stored as such, not as a distribution


class Scan(NamedTuple):
    """A CObservation2DRangeScan."""

    stamp_ns: int
    label: str
    view_rad: float
    right_to_left: bool  # anticlockwise, seen from above a laser that stands upright
    range_max: float  # m
    mount: tuple[float, float, float, float]  # m, m, rad; height of the laser's own z axis
    ranges: NDArray[np.float32]  # (n,) m
    valid: NDArray[np.bool_]  # (n,)


class Wheels(NamedTuple):
    """A CObservationOdometry: odom_T_base."""

    stamp_ns: int
    x: float
    y: float
    theta: float


class Moved(NamedTuple):
    """A CActionRobotMovement2D by odometry: the step since the frame before."""

    x: float
    y: float
    theta: float


class _Bytes:
    """A place in the data that moves on; reading beyond the end raises struct.error."""

    def __init__(self, data: bytes, at: int) -> None:
        self.data, self.at = data, at

    def one(self, form: str) -> float:
        (value,) = self.many(form)
        return value

    def many(self, form: str) -> tuple[float, ...]:
        found = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return found

    def count(self, limit: int) -> int:
        value = int(self.one("I"))
        if value > limit:
            raise ValueError("more than there can be")
        return value

    def member(self, name: str) -> int:
        """Step over the header of a member, and return its version."""
        length = int(self.one("B")) & 0x7F
        found = self.data[self.at : self.at + length].rpartition(b":")[2]
        if found not in (name.encode(), name.encode() + b"F"):  # CMatrix became CMatrixF
            raise ValueError(f"another class than {name}")
        self.at += length
        return int(self.one("B"))

    def end(self) -> None:
        if self.one("B") != _END:
            raise ValueError("no end flag")


def read_object(name: str, data: bytes, at: int) -> tuple[Scan | Wheels | Moved, int] | None:
    """Return the object whose version stands at `at`, and where it ends; None if it is not one."""
    stream = _Bytes(data, at)
    readers: dict[str, Callable[[_Bytes, int], Scan | Wheels | Moved | None]] = {
        "CObservation2DRangeScan": _scan,
        "CObservationOdometry": _wheels,
        "CActionRobotMovement2D": _moved,
    }
    try:
        found = readers[name](stream, int(stream.one("B")))
    except (struct.error, ValueError, UnicodeDecodeError):
        return None
    return (found, stream.at) if found is not None else None


def _scan(stream: _Bytes, version: int) -> Scan:
    if not 4 <= version <= 8:
        raise ValueError("an unknown version")
    view_rad, right_to_left, range_max = stream.many("f?f")
    mount = _pose3(stream)
    if version < 6:
        _step_over_matrix(stream)
    n = stream.count(_BEAMS_LIMIT)
    ranges = np.array(stream.many(f"{n}f"), dtype=np.float32)
    valid = np.array(stream.many(f"{n}b"), dtype=np.int8) != 0
    stream.one("f")  # sigma
    stamp_ns = _stamp_ns(stream)
    stream.one("f")  # width of a beam
    label = ""
    if version >= 5:
        label = _text(stream)
        stream.one("d")  # change of pitch
    if version >= 7 and stream.one("?"):
        stream.many(f"{n}i")
    if version >= 8:
        stream.one("f")  # duration of the sweep
    stream.end()
    if not (math.isfinite(view_rad) and 0.0 < view_rad <= 1.001 * math.tau):
        raise ValueError("no field of view")
    return Scan(stamp_ns, label, view_rad, bool(right_to_left), range_max, mount, ranges, valid)


def _wheels(stream: _Bytes, version: int) -> Wheels:
    if version > 2:
        raise ValueError("an unknown version")
    pose = _pose2(stream)
    _text(stream)
    stamp_ns = _stamp_ns(stream)
    if version >= 1:
        if stream.one("?") or version < 2:
            stream.many("ii")  # ticks
        if stream.one("?") and version == 2:
            stream.many("ddd")
        if version < 2:
            stream.many("ff")
    stream.end()
    return Wheels(stamp_ns, *pose)


def _moved(stream: _Bytes, version: int) -> Moved | None:
    """The step, which comes first; what follows of the object differs and is not needed."""
    if not 2 <= version <= 7:
        raise ValueError("an unknown version")
    if stream.one("I") != _BY_ODOMETRY:
        return None
    return Moved(*_pose2(stream))


def _pose2(stream: _Bytes) -> tuple[float, float, float]:
    version = stream.member("CPose2D")
    if version > 1:
        raise ValueError("an unknown version")
    x, y, theta = stream.many("ddd" if version else "fff")
    stream.end()
    if not math.isfinite(x + y + theta):
        raise ValueError("no pose")
    return x, y, theta


def _pose3(stream: _Bytes) -> tuple[float, float, float, float]:
    if stream.member("CPose3D") != 2:
        raise ValueError("an unknown version")
    x, y, _, w, i, j, k = stream.many("7d")
    stream.end()
    if not math.isfinite(x + y) or abs(math.hypot(w, i, j, k) - 1.0) > 0.01:
        raise ValueError("no pose")
    heading = math.atan2(2.0 * (i * j + w * k), 1.0 - 2.0 * (j * j + k * k))
    return x, y, heading, 1.0 - 2.0 * (i * i + j * j)


def _step_over_matrix(stream: _Bytes) -> None:
    stream.member("CMatrix")
    rows, columns = stream.count(100), stream.count(100)
    stream.many(f"{rows * columns}f")
    stream.end()


def _stamp_ns(stream: _Bytes) -> int:
    stamp_ns = (int(stream.one("Q")) - _1601_TO_1970) * 100
    if not 0 <= stamp_ns < 1 << 62:
        raise ValueError("no time")
    return stamp_ns


def _text(stream: _Bytes) -> str:
    length = stream.count(_LABEL_LIMIT)
    text = stream.data[stream.at : stream.at + length].decode()
    stream.at += length
    return text
