"""The lines of a CARMEN log: their fields, and what is known of the laser behind them.

Field order after CARMEN's own log headers ("message formats defined").  In laser messages
the laser's pose comes first, the robot's second; the stamp is the IPC time stamp, which is
when the reading was made; the logger's own, last on the line, is when it was written.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from slam.logs.messages import LaserScan

SENTINEL_M = 50.0
"""From here on a SICK's reading means "nothing came back" unless the log declares a reach.

The LMS reports 81.83 and 81.91 m, drivers that rescale it 51.1 or 50 m; a wall was never
seen beyond 45 m in the logs we have.
"""

DECLARED_SHARE = 0.998
"""A declared reach is the nominal one; the code for "nothing" may lie a little under it.

81.92 m is declared for a SICK whose codes begin at 81.83 m.
"""

BEAMS_LIMIT = 10_000
WIDE = "more beams than a SICK has, and no field of view: say --fov DEGREES"

NS = 1_000_000_000  # in a second
_LATEST_S = 2**33  # the year 2242; nanoseconds beyond 2262 do not fit 64 bits

_PoseTriple = tuple[float, float, float]


class LineError(Exception):
    """A line cannot be used; the message is a short cause, for counting."""


SICK_BEAMS = 361
"""No SICK that FLASER lines were made for has more beams in its half turn."""


class LaserLine(NamedTuple):
    """A FLASER, ROBOTLASER1 or RAWLASER1 line."""

    scan: LaserScan
    laser: _PoseTriple | None  # odom_T_laser, m and rad; None in RAWLASER1
    robot: _PoseTriple | None  # odom_T_base
    repaired: int  # beams that were negative, zero or no numbers


@dataclass(slots=True)
class Reach:
    """How far the front laser sees, as PARAM lines declare it; nan if they do not (m)."""

    declared: float = math.nan


def flaser(fields: list[bytes], reach: Reach, view_deg: float = 0.0) -> LaserLine:
    """Read `FLASER n r... laser_pose robot_pose stamp host logger_stamp`.

    Such a line says nothing of angles.  It comes from a SICK that looks half a turn wide,
    from -90 degrees on: an even number of beams leaves out the last one (180 beams in steps
    of 1 degree, 360 of 0.5), an odd number has both ends (181, 361).  Where another field of
    view is given (deg), it takes the place of the half turn.

    Raises:
        LineError: if it cannot be used; with more beams than a SICK has, the view must be given.
    """
    n = _beam_count(fields, 1)
    if len(fields) != n + 11:
        raise LineError("wrong number of fields for its beams")
    if n > SICK_BEAMS and not view_deg:
        raise LineError(WIDE)
    view = math.radians(view_deg) if view_deg else math.pi
    step = view / (n if n % 2 == 0 else n - 1)
    ranges, repaired = _ranges(fields[2 : 2 + n], reach.declared)
    scan = LaserScan(_stamp(fields[-3]), -view / 2, step, ranges, range_max=_limit(reach.declared))
    return LaserLine(scan, *_poses(fields[2 + n : 8 + n]), repaired)


def robotlaser(fields: list[bytes], reach: Reach) -> LaserLine:
    """Read a ROBOTLASER1 line, which describes its own geometry.

    `ROBOTLASER1 type start_angle fov resolution max_range accuracy remission_mode n r... m
    remission... laser_pose robot_pose tv rv forward_safety side_safety turn_axis stamp host
    logger_stamp`, angles in rad.  The type and the remission are not used.

    Raises:
        LineError: if it cannot be used.
    """
    scan, repaired, poses = _described(fields, reach, behind=14)
    return LaserLine(scan, *_poses(fields[poses : poses + 6]), repaired)


def rawlaser(fields: list[bytes], reach: Reach) -> LaserLine:
    """Read `RAWLASER1 ...`, as ROBOTLASER1 without the poses and what follows them.

    Raises:
        LineError: if it cannot be used.
    """
    scan, repaired, _ = _described(fields, reach, behind=3)
    return LaserLine(scan, None, None, repaired)


def _described(fields: list[bytes], reach: Reach, behind: int) -> tuple[LaserScan, int, int]:
    """Read a line that describes its geometry; `behind` fields follow the remissions.

    Returns the scan, how many ranges had to become nan, and where those fields begin.
    """
    n = _beam_count(fields, 8, least=1)
    after = 9 + n
    if len(fields) <= after:
        raise LineError("wrong number of fields for its beams")
    poses = after + 1 + _beam_count(fields, after, least=0)
    if len(fields) != poses + behind:
        raise LineError("wrong number of fields for its beams")
    start, _, step, declared = _numbers(fields[2:6])
    if not (math.isfinite(start) and math.isfinite(step) and step):
        raise LineError("no angle between beams")
    if not declared > 0:  # 0 where a logger did not know
        declared = reach.declared
    ranges, repaired = _ranges(fields[9:after], declared)
    scan = LaserScan(_stamp(fields[-3]), start, step, ranges, range_max=_limit(declared))
    return scan, repaired, poses


def odometry(fields: list[bytes]) -> tuple[int, _PoseTriple]:
    """Read `ODOM x y theta tv rv accel stamp host logger_stamp`: stamp in ns, pose.

    Raises:
        LineError: if it cannot be used.
    """
    if len(fields) != 10:
        raise LineError("wrong number of fields")
    x, y, theta = _numbers(fields[1:4])
    if not math.isfinite(x + y + theta):
        raise LineError("pose is not finite")
    return _stamp(fields[-3]), (x, y, theta)


def parse_stamp(text: bytes) -> int:
    """Return a time in seconds, written in decimal, as exact nanoseconds.

    A double would be off by 120 ns for today's times.

    Raises:
        ValueError: if it is no time from 1970 on.
    """
    whole, _, fraction = text.partition(b".")
    plain = whole.isdigit() and len(whole) <= 10 and (not fraction or fraction.isdigit())
    if plain and int(whole) < _LATEST_S:
        return int(whole) * NS + int(fraction[:9].ljust(9, b"0"))
    try:
        seconds = Decimal(text.decode("ascii"))
    except InvalidOperation as error:
        raise ValueError("not a number") from error
    if not (seconds.is_finite() and 0 <= seconds < _LATEST_S):
        raise ValueError("not a time from 1970 on")
    return int(seconds * NS)


def _stamp(text: bytes) -> int:
    try:
        return parse_stamp(text)
    except ValueError as error:
        raise LineError("stamp is not a time") from error


def _beam_count(fields: list[bytes], at: int, least: int = 2) -> int:
    try:
        n = int(fields[at])
    except (ValueError, IndexError) as error:
        raise LineError("no number of beams") from error
    if not least <= n <= BEAMS_LIMIT:
        raise LineError("impossible number of beams")
    return n


def _numbers(fields: list[bytes]) -> list[float]:
    try:
        return list(map(float, fields))
    except ValueError as error:
        raise LineError("a field is not a number") from error


def _poses(fields: list[bytes]) -> tuple[_PoseTriple, _PoseTriple]:
    a, b, c, x, y, theta = _numbers(fields)
    if not math.isfinite(a + b + c + x + y + theta):
        raise LineError("pose is not finite")
    return (a, b, c), (x, y, theta)


def _limit(declared: float) -> float:
    """Return the range from which on a reading means that nothing came back (m)."""
    return SENTINEL_M if math.isnan(declared) else declared * DECLARED_SHARE


def _ranges(fields: list[bytes], declared: float) -> tuple[NDArray[np.float32], int]:
    """Return ranges with inf for "nothing came back", and how many had to become nan."""
    values = np.array(_numbers(fields))
    values[values >= _limit(declared)] = np.inf
    unusable = ~(values > 0.0)  # zero, negative, nan
    repaired = int(np.count_nonzero(unusable))
    if repaired:
        values[unusable] = np.nan
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(np.float32), repaired
