"""Stamped planar poses, and the TUM text format.

TUM lines are `t x y z qx qy qz qw` (Sturm et al. 2012, "A Benchmark for the Evaluation of
RGB-D SLAM Systems"): seconds, metres, a unit quaternion.  Stamps stay integer nanoseconds
from end to end, because a double of UTC seconds resolves only 0.2 microseconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError

Poses = NDArray[np.float64]  # (n, 3) rows of x (m), y (m), theta (rad)
Stamps = NDArray[np.int64]  # (n,) ns of UTC

NS = 1_000_000_000


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """`map_T_base` at given times, in order of time.

    Raises:
        ValueError: if shapes disagree or a stamp is earlier than the one before.
    """

    stamps_ns: Stamps  # (n,) ns, never decreasing
    poses: Poses  # (n, 3) x (m), y (m), theta (rad)

    def __post_init__(self) -> None:
        """Check the shapes and the order, and freeze both arrays."""
        n = len(self.stamps_ns)
        if self.stamps_ns.shape != (n,) or self.poses.shape != (n, 3):
            raise ValueError(
                f"a trajectory needs (n,) stamps and (n, 3) poses, "
                f"got {self.stamps_ns.shape} and {self.poses.shape}"
            )
        if self.stamps_ns.dtype != np.int64 or self.poses.dtype != np.float64:
            raise ValueError("a trajectory needs int64 stamps and float64 poses")
        if np.any(np.diff(self.stamps_ns) < 0):
            raise ValueError("the stamps of a trajectory must not run backwards")
        self.stamps_ns.setflags(write=False)
        self.poses.setflags(write=False)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def select(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Trajectory:
        """Return the trajectory of the chosen rows (indices in order, or a mask)."""
        return Trajectory(self.stamps_ns[rows], self.poses[rows])

    def seconds(self) -> NDArray[np.float64]:
        """Return seconds since the first pose, (n,)."""
        return (self.stamps_ns - self.stamps_ns[:1]) / NS


def path_length(poses: Poses) -> NDArray[np.float64]:
    """Return the metres travelled up to each pose, (n,), starting with 0."""
    steps = np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1]))
    return np.concatenate([np.zeros(min(1, len(poses))), np.cumsum(steps)])


class WrongUnit(ValueError):  # noqa: N818
    """A stamp is far beyond any time in seconds: it counts something smaller."""


_UNITS = ((1e17, "nanoseconds"), (1e14, "microseconds"), (1e11, "milliseconds"))
"""What times since 1973 come to when they are counted in something else than seconds."""


def parse_stamp(text: str) -> int:
    """Return decimal seconds as integer nanoseconds without passing through a float.

    Digits beyond the ninth are cut.

    Raises:
        WrongUnit: it is beyond the year 2262, which nanoseconds in 64 bits cannot count.
        ValueError: if the text is not a decimal number.
    """
    stamp = _stamp_of(text)
    if abs(stamp) >= 2**63:
        unit = next((f" ({name}?)" for least, name in _UNITS if abs(stamp) >= least * NS), "")
        raise WrongUnit(f"stamp {text.strip()[:40]} is no time in seconds{unit}")
    return stamp


def _stamp_of(text: str) -> int:
    text = text.strip()
    negative = text.startswith("-")
    whole, _, fraction = text.lstrip("+-").partition(".")
    if not (whole + fraction).isdigit():
        value = float(text)  # 1.6e9 and the like
        if not math.isfinite(value):
            raise ValueError(f"{text!r} is not a time")
        return round(value * NS)
    stamp = int(whole or "0") * NS + int(fraction[:9].ljust(9, "0"))
    return -stamp if negative else stamp


def format_stamp(stamp_ns: int) -> str:
    """Return nanoseconds as decimal seconds with all nine decimals."""
    seconds, nanoseconds = divmod(abs(stamp_ns), NS)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09d}"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write the trajectory as TUM text; equal trajectories give equal bytes.

    Raises:
        OSError: if the file cannot be written.
    """
    lines = (
        f"{format_stamp(stamp)} {x!r} {y!r} 0.0 0.0 0.0 "
        f"{math.sin(theta / 2.0)!r} {math.cos(theta / 2.0)!r}\n"
        for stamp, (x, y, theta) in zip(
            trajectory.stamps_ns.tolist(), trajectory.poses.tolist(), strict=True
        )
    )
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(lines)


def read_tum(path: Path) -> Trajectory:
    """Read TUM text, ordered by time; the heading is the yaw of the quaternion.

    Poses that say nan are kept: what to do with them is the reader's decision.

    Raises:
        LogError: if the file cannot be read or a line is not a TUM pose.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                stamp, pose = _parse_tum_line(line)
            except WrongUnit as error:
                raise LogError(f"{path}:{number}: {error}") from error
            except ValueError as error:
                raise LogError(f"{path}:{number}: not a TUM pose: {error}") from error
            stamps.append(stamp)
            poses.append(pose)
    return sorted_trajectory(stamps, poses)


def sorted_trajectory(stamps_ns: list[int], poses: list[tuple[float, float, float]]) -> Trajectory:
    """Build a trajectory from poses in any order; equal stamps keep theirs."""
    stamps = np.array(stamps_ns, dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    return Trajectory(stamps[order], np.array(poses, dtype=np.float64).reshape(-1, 3)[order])


def _parse_tum_line(line: str) -> tuple[int, tuple[float, float, float]]:
    fields = line.replace(",", " ").split()
    if len(fields) != 8:
        raise ValueError(f"expected `t x y z qx qy qz qw`, found {len(fields)} fields")
    x, y, _, qx, qy, qz, qw = (float(field) for field in fields[1:])
    if math.isfinite(qx + qy + qz + qw) and qx * qx + qy * qy + qz * qz + qw * qw < 1e-6:
        raise ValueError("the quaternion is zero")
    return parse_stamp(fields[0]), (x, y, _yaw(qx, qy, qz, qw))


def _yaw(qx: float, qy: float, qz: float, qw: float) -> float:
    """Return the heading; the half-angle form keeps full precision for planar poses."""
    if qx == 0.0 and qy == 0.0:
        theta = 2.0 * math.atan2(qz, qw)
        return theta if -math.pi <= theta <= math.pi else math.remainder(theta, 2.0 * math.pi)
    return math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
