"""Messages as a CARMEN log.

What the format holds survives exactly: stamps to the nanosecond, ranges, poses, the mount
and angles to the last bit.  What it does not is lost: `range_min`, `beam_period_s`, scans
without beams, and messages other than scans, odometry and the mount.  `range_max` changes
in its last digit, and to 50 m if it was not finite; a reading from there on becomes inf.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError
from slam.logs.importers.carmen_lines import DECLARED_SHARE, NS, SENTINEL_M, SICK_BEAMS
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.logs.partial import PartialFile

_NOTHING_M = 81.91
"""What a SICK reports where nothing came back."""

_Pose = tuple[float, float, float]


def write_carmen(path: Path | str, messages: Iterable[Message]) -> int:
    """Write a CARMEN log and return the number of scans in it.

    Raises:
        LogError: if the file cannot be written or there is no scan.
    """
    out = PartialFile(Path(path), keep=False)
    scans = 0
    try:
        for line in carmen_lines(messages):
            scans += line.startswith(("FLASER", "ROBOTLASER1"))
            out.stream.write(line.encode("ascii") + b"\n")
        if not scans:
            raise LogError(f"{path}: there is no scan to write")
        out.commit()
    except OSError as error:
        out.abandon()
        raise LogError(f"{path}: writing failed: {error.strerror}") from error
    except BaseException:
        out.abandon()
        raise
    return scans


def carmen_lines(messages: Iterable[Message]) -> Iterator[str]:
    """Yield the lines of a CARMEN log.

    A scan takes the pose of the odometry message last seen (zero before the first).
    """
    yield "# CARMEN log; angles in rad, lengths in m, times in s"
    extrinsics: _Pose = (0.0, 0.0, 0.0)
    robot: _Pose = (0.0, 0.0, 0.0)
    for message in messages:
        if isinstance(message, LaserExtrinsics):
            extrinsics = (message.x, message.y, message.theta)
            yield from _mount_lines(extrinsics)
        elif isinstance(message, WheelOdometry):
            robot = (message.x, message.y, message.theta)
            yield f"ODOM {_numbers(robot)} 0 0 0 {_ending(message.stamp_ns)}"
        elif isinstance(message, LaserScan):
            yield _scan_line(message, _compose(robot, extrinsics), robot)


def _mount_lines(extrinsics: _Pose) -> Iterator[str]:
    names = ("offset", "side_offset", "angular_offset")
    for name, value in zip(names, extrinsics, strict=True):
        yield f"PARAM robot_frontlaser_{name} {value!r} nohost 0"


def _scan_line(scan: LaserScan, laser: _Pose, robot: _Pose) -> str:
    """Write FLASER where its fixed geometry is the scan's, else ROBOTLASER1."""
    n = len(scan.ranges)
    poses = f"{_numbers(laser)} {_numbers(robot)}"
    ending = _ending(scan.stamp_ns)
    if _is_flaser(scan):
        return f"FLASER {n} {_ranges(scan.ranges, _NOTHING_M)} {poses} {ending}"
    reach = scan.range_max / DECLARED_SHARE
    declared = reach if 0 < reach < math.inf else 0.0  # 0: unknown
    nothing = declared or _NOTHING_M
    geometry = (scan.angle_min, scan.angle_step * (n - 1), scan.angle_step, declared)
    return (
        f"ROBOTLASER1 0 {_numbers(geometry)} 0.01 0 {n} {_ranges(scan.ranges, nothing)} 0 "
        f"{poses} 0 0 0 0 0 {ending}"
    )


def _is_flaser(scan: LaserScan) -> bool:
    n = len(scan.ranges)
    return (
        1 < n <= SICK_BEAMS
        and scan.angle_min == -math.pi / 2
        and scan.angle_step == math.pi / (n - n % 2)
        and scan.range_max == SENTINEL_M
    )


def _ranges(ranges: NDArray[np.float32], nothing: float) -> str:
    """Write each range in the fewest digits that read back the same; nan as 0."""
    written = np.where(np.isposinf(ranges), np.float32(nothing), ranges)
    written[~(written > 0)] = 0.0
    texts = [str(value) for value in written]
    exact = np.array(list(map(float, texts))).astype(np.float32) == written
    if not exact.all():  # shortest for single precision, but read as double and rounded twice
        for i in np.flatnonzero(~exact):
            texts[i] = repr(float(written[i]))
    return " ".join(texts)


def _compose(a: _Pose, b: _Pose) -> _Pose:
    """Return the product of two poses, exact where the second is none."""
    if b == (0.0, 0.0, 0.0):
        return a
    c, s = math.cos(a[2]), math.sin(a[2])
    theta = math.remainder(a[2] + b[2], math.tau)
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], theta


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _ending(stamp_ns: int) -> str:
    stamp = f"{stamp_ns // NS}.{stamp_ns % NS:09d}"
    return f"{stamp} nohost {stamp}"
