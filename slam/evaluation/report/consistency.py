"""What a run says about itself without any truth: how well its own parts agree.

Small figures here prove nothing: a map can be sharp and bent.  Large ones are a warning.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import between, compose, wrap
from slam.evaluation.metrics import associate, pairs_by_path, relative_errors, summarise
from slam.evaluation.report.read_run import Run
from slam.logs.messages import FactorRecord, LaserExtrinsics, LaserScan
from slam.logs.trajectory import Poses, Trajectory

CELL_M = 0.25  # of the grid in which points of many scans are put together
LEAST_POINTS = 20  # in a cell that tells of a wall
LEAST_SCANS = 4  # that saw it: one scan alone is always sharp
_STRAIGHT = 0.3  # a wall's thickness is less than so much of its length within the cell
_FARTHEST_M = 20.0  # beams beyond spread too much to tell


def consistency(run: Run) -> dict[str, Any]:
    """Return the figures that this run's records allow."""
    return (
        closure_residuals(run.records.factors, run.keyframes)
        | odometry_against_matches(run.records.factors)
        | odometry_against_trajectory(run.odometry, run.trajectory)
        | map_sharpness(run.records.scans, run.records.extrinsics, run.trajectory)
    )


def closure_residuals(
    factors: Sequence[FactorRecord], keyframes: Trajectory | None
) -> dict[str, Any]:
    """How far the optimised keyframes are from what the accepted closures measured."""
    loops = [f for f in factors if f.kind == "loop" and f.used]
    loops = [f for f in loops if keyframes is not None and max(f.i, f.j) < len(keyframes)]
    if not loops or keyframes is None:
        return {}
    i_T_j = between(keyframes.poses[[f.i for f in loops]], keyframes.poses[[f.j for f in loops]])
    residual = between(_motions(loops), i_T_j)
    length = np.hypot(residual[:, 0], residual[:, 1])
    return {
        "closure_residual_median_m": float(np.median(length)),
        "closure_residual_max_m": float(np.max(length)),
        "closure_residual_median_deg": float(np.degrees(np.median(np.abs(wrap(residual[:, 2]))))),
    }


def odometry_against_matches(factors: Sequence[FactorRecord]) -> dict[str, Any]:
    """How far the wheels and the matches differ over the same step, refused ones included."""
    wheels = {(f.i, f.j): f for f in factors if f.kind == "odometry"}
    both = [(wheels[f.i, f.j], f) for f in factors if f.kind == "icp" and (f.i, f.j) in wheels]
    if not both:
        return {}
    error = between(_motions([w for w, _ in both]), _motions([m for _, m in both]))
    length = np.hypot(error[:, 0], error[:, 1])
    return {
        "odometry_against_icp_median_m": float(np.median(length)),
        "odometry_against_icp_p95_m": float(np.percentile(length, 95)),
        "odometry_against_icp_median_deg": float(np.degrees(np.median(np.abs(wrap(error[:, 2]))))),
        "odometry_refused_share": float(np.mean([not w.used for w, _ in both])),
    }


def odometry_against_trajectory(
    odometry: Trajectory | None, trajectory: Trajectory
) -> dict[str, Any]:
    """How far the wheels and the finished trajectory differ after each metre of path."""
    if odometry is None or not len(odometry):
        return {}
    pairs = associate(odometry, trajectory)
    rows = pairs_by_path(pairs.truth.poses, 1.0)
    if not len(rows):
        return {}
    errors = relative_errors(pairs, rows)
    return {"odometry_disagreement_per_m": summarise(errors.trans_m).median}


def map_sharpness(
    scans: Sequence[LaserScan], extrinsics: LaserExtrinsics | None, trajectory: Trajectory
) -> dict[str, Any]:
    """How thick the walls are where several keyframes saw them.

    All points are put into cells; in a cell with a straight piece of wall the points scatter
    about it by range noise and by errors of the poses.  Given are the median and the 90th
    percentile over these cells of that scatter, across the wall (RMS).
    """
    rows = _rows(scans, trajectory)
    if not rows:
        return {}
    at = np.array([extrinsics.x, extrinsics.y, extrinsics.theta]) if extrinsics else np.zeros(3)
    poses = compose(trajectory.poses[[row for _, row in rows]], at)
    points, source = _points([scans[k] for k, _ in rows], poses)
    thickness = wall_thickness(points, source)
    if not len(thickness):
        return {}
    return {
        "wall_thickness_median_m": float(np.median(thickness)),
        "wall_thickness_p90_m": float(np.percentile(thickness, 90)),
        "wall_cells": len(thickness),
    }


def wall_thickness(points: NDArray[np.float64], source: NDArray[np.int64]) -> NDArray[np.float64]:
    """RMS scatter across the wall, m, of each cell that holds a straight piece of wall.

    Args:
        points: (n, 2) m, in the map frame.
        source: (n,) the scan that each is from.
    """
    if not len(points):
        return np.zeros(0)
    cells = np.floor(points / CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    key = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    _, index = np.unique(key, return_inverse=True)
    count = np.bincount(index)
    many = int(source.max()) + 1
    scans = np.bincount(np.unique(index * many + source) // many, minlength=len(count))
    local = points - points.mean(axis=0)
    mean = np.column_stack([np.bincount(index, local[:, k]) for k in (0, 1)]) / count[:, None]
    x, y = (local - mean[index]).T
    xx, xy, yy = (np.bincount(index, v) / count for v in (x * x, x * y, y * y))
    middle, half = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    across, along = np.sqrt(np.maximum(middle - half, 0.0)), np.sqrt(middle + half)
    wall = (count >= LEAST_POINTS) & (scans >= LEAST_SCANS) & (across < _STRAIGHT * along)
    return np.asarray(across[wall])


def _rows(scans: Sequence[LaserScan], trajectory: Trajectory) -> list[tuple[int, int]]:
    """Scans that have a pose: their number and the row of the trajectory."""
    place = {stamp: row for row, stamp in enumerate(trajectory.stamps_ns.tolist())}
    return [(k, place[s.stamp_ns]) for k, s in enumerate(scans) if s.stamp_ns in place]


def _points(
    scans: Sequence[LaserScan], poses: Poses
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points of scans at `map_T_laser` (n, 3), and the scan that each is from."""
    points, source = [], []
    for k, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        ranges = scan.ranges.astype(np.float64)
        farthest = min(scan.range_max, _FARTHEST_M)
        good = np.isfinite(ranges) & (ranges > scan.range_min) & (ranges < farthest)
        bearings = pose[2] + scan.angle_min + scan.angle_step * np.flatnonzero(good)
        reach = ranges[good]
        points.append(
            pose[:2] + np.column_stack([np.cos(bearings), np.sin(bearings)]) * reach[:, None]
        )
        source.append(np.full(len(reach), k))
    return np.concatenate(points), np.concatenate(source)


def _motions(factors: Sequence[FactorRecord]) -> Poses:
    return np.array([(f.x, f.y, f.theta) for f in factors])
