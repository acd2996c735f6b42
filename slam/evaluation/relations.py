"""The relations metric of Kuemmerle et al. 2009, "On measuring the accuracy of SLAM algorithms".

A relation says where the robot stood at time t2 as seen from where it stood at t1.  The
metric compares relative motions only, so it needs no alignment and no common frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import between
from slam.logs.trajectory import NS, Poses, Stamps, Trajectory, parse_stamp
from slam.runs.errors import ReportError

MATCH_TOLERANCE_S = 0.02
"""Farthest a pose may be from a relation's time: half a scan period at 25 Hz, 1 cm at 0.5 m/s."""


@dataclass(frozen=True, eq=False, slots=True)
class Relations:
    """Surveyed relative poses: `first_T_second` between the base at two times."""

    first_ns: Stamps  # (n,) t1
    second_ns: Stamps  # (n,) t2, sometimes before t1
    first_T_second: Poses

    def __len__(self) -> int:
        return len(self.first_ns)


@dataclass(frozen=True, eq=False, slots=True)
class RelationErrors:
    """What the metric found, one row for each relation that the trajectory covers."""

    trans_m: NDArray[np.float64]  # (m,) length of the translational error
    rot_deg: NDArray[np.float64]  # (m,) absolute rotational error
    at_ns: Stamps  # (m,) the later time of the relation
    missing: int  # relations without a pose near one of their times
    rows: NDArray[np.intp]  # (m,) which of the relations these are

    def summary(self) -> dict[str, float | int | None]:
        """Return the figures under the names of `report.json`; None where there is nothing."""
        some = len(self.trans_m) > 0
        return {
            "n": len(self.trans_m),
            "missing": self.missing,
            "trans_mean_m": float(np.mean(self.trans_m)) if some else None,
            "trans_std_m": float(np.std(self.trans_m)) if some else None,
            "trans_median_m": float(np.median(self.trans_m)) if some else None,
            "trans_max_m": float(np.max(self.trans_m)) if some else None,
            "rot_mean_deg": float(np.mean(self.rot_deg)) if some else None,
            "rot_std_deg": float(np.std(self.rot_deg)) if some else None,
        }


def read_relations(path: Path) -> Relations:
    """Read lines of `t1 t2 x y z roll pitch yaw` (s, m, rad).

    Raises:
        ReportError: if the file cannot be read, a line is malformed, or there is none.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise ReportError(f"{path}: cannot be read: {error.strerror}") from error
    times: list[tuple[int, int]] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            times.append((parse_stamp(fields[0]), parse_stamp(fields[1])))
            poses.append(_pose(fields))
        except (ValueError, IndexError) as error:
            raise ReportError(
                f"{path}:{number}: not a relation `t1 t2 x y z roll pitch yaw`: {error}"
            ) from error
    if not times:
        raise ReportError(f"{path}: holds no relations")
    stamps = np.array(times, dtype=np.int64)
    return Relations(stamps[:, 0], stamps[:, 1], np.array(poses, dtype=np.float64))


def _pose(fields: list[str]) -> tuple[float, float, float]:
    if len(fields) != 8:
        raise ValueError(f"{len(fields)} fields")
    x, y, theta = float(fields[2]), float(fields[3]), float(fields[7])
    if not math.isfinite(x + y + theta):
        raise ValueError("a value is not finite")
    return x, y, theta


def relation_errors(
    trajectory: Trajectory, relations: Relations, tolerance_s: float = MATCH_TOLERANCE_S
) -> RelationErrors:
    """Compare the trajectory's relative motions with the relations (Kuemmerle 2009, Eq. 3).

    With delta = inverse(X(t1)) X(t2), the error is inverse(delta*) delta.  Each time takes
    the nearest pose within `tolerance_s`; relations without one are counted as missing.
    """
    first, first_found = nearest_rows(trajectory.stamps_ns, relations.first_ns, tolerance_s)
    second, second_found = nearest_rows(trajectory.stamps_ns, relations.second_ns, tolerance_s)
    found = first_found & second_found
    delta = between(trajectory.poses[first[found]], trajectory.poses[second[found]])
    error = between(relations.first_T_second[found], delta)
    return RelationErrors(
        trans_m=np.hypot(error[:, 0], error[:, 1]),
        rot_deg=np.degrees(np.abs(error[:, 2])),
        at_ns=np.maximum(relations.first_ns, relations.second_ns)[found],
        missing=int(np.count_nonzero(~found)),
        rows=np.flatnonzero(found),
    )


def nearest_rows(
    stamps_ns: Stamps, wanted_ns: Stamps, tolerance_s: float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return for each wanted time the nearest row of ordered stamps, and whether it is near enough.

    Of two equally near rows the earlier is taken.  Rows are meaningless where not found.
    """
    if len(stamps_ns) == 0:
        nothing = np.zeros(len(wanted_ns), dtype=np.intp)
        return nothing, np.zeros(len(wanted_ns), dtype=np.bool_)
    after = np.searchsorted(stamps_ns, wanted_ns).clip(0, len(stamps_ns) - 1)
    before = (after - 1).clip(0)
    to_before = np.abs(wanted_ns - stamps_ns[before])
    to_after = np.abs(stamps_ns[after] - wanted_ns)
    rows = np.where(to_before <= to_after, before, after)
    near = np.minimum(to_before, to_after) <= round(tolerance_s * NS)
    return rows, near
