"""CARMEN logs (`.clf`, `.log`, plain or gzipped): FLASER, ROBOTLASER1 and RAWLASER1.

Rules for what CARMEN leaves open:

- a FLASER or ROBOTLASER1 line gives a scan and, with the same stamp, the robot's odometry
  (its second pose); ODOM lines are left out then unless asked for, because they repeat it
  at other times;
- RAWLASER1 lines hold no pose: they are read where there are no others, with the ODOM lines
  between them, or as a laser alone where there are none of these;
- the laser's mount is the PARAM `robot_frontlaser_offset` (and its kin), zero without it,
  unless the poses contradict: the laser's seen from the robot's is constant, and another;
  poses that are equal contradict nothing, many a log repeats the robot's;
- readings from the declared reach on, or from 50 m on where none is declared, are inf;
  negative, zero and nan ones are nan, and counted;
- a line that cannot be used is skipped and counted by cause; a log without one usable
  scan is refused.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.importers import carmen_lines
from slam.logs.importers.carmen_lines import WIDE, LaserLine, LineError, Reach
from slam.logs.importers.imported import ImportedLog, Reading, as_messages, in_stamp_order
from slam.logs.importers.text_lines import lines
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import WheelOdometry

_REACH_PARAMS = {
    b"robot_front_laser_max",
    b"robot_frontlaser_max",
    b"robot_front_laser_max_range",
    b"laser_front_laser_max_range",
}
_MOUNT_PARAMS = {  # CARMEN's names for x, y and theta of base_T_laser
    b"robot_frontlaser_offset": 0,
    b"robot_frontlaser_side_offset": 1,
    b"robot_frontlaser_angular_offset": 2,
}
_RIGID_M, _RIGID_RAD = 2e-3, 2e-3
"""How much base_T_laser may vary in a log: poses are often written with three digits."""

_Pose = tuple[float, float, float]


_NO_WISHES = Wishes()


def read_carmen(
    path: Path | str, wishes: Wishes = _NO_WISHES, *, odometry_lines: bool = False
) -> ImportedLog:
    """Read a CARMEN log into messages in stamp order.

    Args:
        path: the log, plain or gzipped.
        wishes: mount, drive, span, and the field of view of FLASER lines.
        odometry_lines: whether ODOM lines become messages as well.

    Raises:
        LogError: if the file cannot be read, holds no usable scan, or several drives of which
            none is asked for.
    """
    path = Path(path)
    parser = _Parser(odometry_lines, wishes)
    for line in lines(path, parser.skipped):
        parser.feed(line)
    parser.take_raw()
    if not parser.laser_lines:
        raise LogError(f"{path}: {_nothing_found(parser)}")
    try:
        return parser.finish()
    except LogError as error:
        raise LogError(f"{path}: {error}") from error


def _nothing_found(parser: _Parser) -> str:
    if parser.skipped:
        cause, count = parser.skipped.most_common(1)[0]
        if cause.endswith(WIDE):
            return f"{count} x {cause}"
        return f"no usable scan: {count} x {cause}: is it a CARMEN log?"
    return "holds no FLASER or ROBOTLASER1 line: is it a CARMEN log?"


@dataclass(slots=True)
class _Parser:
    """Collects the lines of one log."""

    odometry_lines: bool
    wishes: Wishes
    laser_lines: list[LaserLine] = field(default_factory=list)
    raw: list[LaserLine | Reading] = field(default_factory=list)  # RAWLASER1 and ODOM, in order
    notes: list[str] = field(default_factory=list)
    readings: list[Reading] = field(default_factory=list)
    reach: Reach = field(default_factory=Reach)
    extrinsics: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    skipped: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)

    def feed(self, line: bytes) -> None:
        """Take in one line."""
        fields = line.split()
        if not fields or fields[0].startswith(b"#"):
            return
        try:
            self._dispatch(fields[0], fields)
        except LineError as error:
            self.skipped[f"{fields[0].decode()}: {error}"] += 1

    def _dispatch(self, kind: bytes, fields: list[bytes]) -> None:
        if kind == b"FLASER":
            self._add_laser(carmen_lines.flaser(fields, self.reach, self.wishes.view_deg))
            self.raw.clear()
        elif kind == b"ROBOTLASER1":
            self._add_laser(carmen_lines.robotlaser(fields, self.reach))
            self.raw.clear()
        elif kind == b"ODOM" and (self.odometry_lines or not self.laser_lines):
            self.ignored["ODOM"] += not self.odometry_lines
            stamp_ns, pose = carmen_lines.odometry(fields)
            reading = Reading(WheelOdometry(stamp_ns, *pose))
            (self.readings if self.odometry_lines else self.raw).append(reading)
        elif kind == b"RAWLASER1":
            self.ignored["RAWLASER1"] += 1
            if not self.laser_lines:
                self.raw.append(carmen_lines.rawlaser(fields, self.reach))
        elif kind == b"PARAM" and len(fields) > 2:
            self._take_parameter(fields[1], fields[2])
        elif kind in KINDS:
            self.ignored[kind.decode()] += 1
        else:
            self.skipped["lines of no known kind"] += 1

    def _add_laser(self, line: LaserLine) -> None:
        if line.repaired:
            self.changed["ranges that were zero, negative or nan, set to nan"] += line.repaired
        beams = line.scan.ranges.size
        if self.laser_lines and beams != self.laser_lines[-1].scan.ranges.size:
            self.changed["changes of the number of beams"] += 1
        self.laser_lines.append(line)
        odometry = WheelOdometry(line.scan.stamp_ns, *line.robot) if line.robot else None
        self.readings.append(Reading(odometry, line.scan))

    def take_raw(self) -> None:
        """Fall back on RAWLASER1 and ODOM lines where there is no laser line with a pose."""
        if self.laser_lines or not any(isinstance(line, LaserLine) for line in self.raw):
            return
        del self.ignored["RAWLASER1"], self.ignored["ODOM"]
        with_odometry = bool(self.readings) or any(isinstance(n, Reading) for n in self.raw)
        self.notes.append(
            "scans from RAWLASER1, odometry from ODOM" if with_odometry
            else "scans from RAWLASER1, no odometry: laser alone"
        )  # fmt: skip
        for line in self.raw:
            if isinstance(line, LaserLine):
                self._add_laser(line)
            else:
                self.readings.append(line)

    def _take_parameter(self, name: bytes, text: bytes) -> None:
        if name not in _REACH_PARAMS and name not in _MOUNT_PARAMS:
            return
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise LineError("value is not a number")
        if name in _MOUNT_PARAMS:
            self.extrinsics[_MOUNT_PARAMS[name]] = value
        elif value > 0:
            self.reach.declared = value

    def finish(self) -> ImportedLog:
        """Order the readings and find the mount."""
        measured = _rigid_mount(self.laser_lines)
        if measured is None:
            self.changed["laser poses that are not rigid to the robot's, not used"] += 1
        extrinsics: _Pose = (self.extrinsics[0], self.extrinsics[1], self.extrinsics[2])
        if measured is not None and any(measured) and not _near(measured, extrinsics):
            extrinsics = measured
        readings = in_stamp_order(self.readings, self.changed, self.skipped, self.wishes)
        messages = as_messages(readings, extrinsics, self.wishes)
        ignored = +self.ignored
        return ImportedLog(
            "CARMEN", messages, self.skipped, self.changed, ignored, notes=self.notes
        )


def _rigid_mount(laser_lines: list[LaserLine]) -> _Pose | None:
    """Return base_T_laser as the first line has it, None if it is not the same in all."""
    first: _Pose | None = None
    for line in laser_lines:
        if line.robot is None or line.laser is None:
            continue
        seen = _between(line.robot, line.laser)
        first = first or seen
        if not _near(seen, first):
            return None
    return first or (0.0, 0.0, 0.0)


def _near(a: _Pose, b: _Pose) -> bool:
    turned = math.remainder(a[2] - b[2], math.tau)
    return math.hypot(a[0] - b[0], a[1] - b[1]) <= _RIGID_M and abs(turned) <= _RIGID_RAD


def _between(a: _Pose, b: _Pose) -> _Pose:
    """Return a_T_b of two poses in one frame."""
    if a == b:
        return 0.0, 0.0, 0.0
    dx, dy = b[0] - a[0], b[1] - a[1]
    c, s = math.cos(a[2]), math.sin(a[2])
    return c * dx + s * dy, c * dy - s * dx, math.remainder(b[2] - a[2], math.tau)


KINDS = {
    b"FLASER",
    *(f"{kind}{number}".encode() for kind in ("RAWLASER", "ROBOTLASER") for number in range(6)),
    *(b"ODOM", b"PARAM", b"SYNC", b"RLASER", b"LASER3", b"LASER4", b"TRUEPOS", b"SONAR"),
    *(b"REMISSIONFLASER", b"BUMPER", b"IMU", b"NMEAGGA", b"NMEARMC", b"NMEAVTG", b"NMEAGSV"),
    *(b"SCANMARK", b"POSITIONLASER", b"GYRO", b"GRIPPER", b"VECMOVE", b"MARKER", b"PANTILT"),
}
"""First words of a CARMEN log's lines, read or passed over (CARMEN's headers, MRPT's docs)."""
