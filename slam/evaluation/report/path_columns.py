"""What is known at each pose of a run: what one sees when pointing at its path."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slam.backend.se2 import between, compose, wrap
from slam.evaluation.relations import MATCH_TOLERANCE_S, nearest_rows
from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.page_data import Values, column, shown_rows
from slam.logs.messages import PoseEstimate
from slam.logs.trajectory import NS, Poses, Trajectory

_SPEED_WINDOW_S = 1.0  # over which speed is taken: shorter ones show the jitter of the poses
_RELATION_REACH_S = 2.5  # farthest a pose may be from a relation whose error it is shown with


def path_columns(report: RunReport) -> dict[str, Any]:
    """Return columns by name, one value a pose; absent where a run does not tell.

    Metres, seconds since the first pose, degrees.  Headings are continuous, without jumps at
    180 degrees, so that they can be drawn.
    """
    run, errors = report.run, pose_errors(report)
    worst = [int(np.nanargmax(errors))] if _some(errors) else []
    rows = shown_rows(len(run.trajectory), np.array(worst, dtype=np.intp))
    shown = run.trajectory.select(rows)
    heading = _continuous(shown.poses)
    sigmas = _sigmas(run.records.estimates, shown)
    known: list[tuple[str, Values, int]] = [
        ("t", shown.seconds(), 3),
        ("x", shown.poses[:, 0], 3),
        ("y", shown.poses[:, 1], 3),
        ("heading", heading, 2),
        ("speed", _speed(shown), 2),
        ("error", errors[rows], 4),
        ("sigma", sigmas[:, 0], 4),
        ("sigma_heading", sigmas[:, 1], 3),
    ]
    odometry, truth = _odometry(report, shown), _truth(report)[rows]
    beside = heading + np.degrees(wrap(truth[:, 2] - np.radians(heading)))
    for name, poses, angles in (
        ("odometry", odometry, _continuous(odometry)),
        ("truth", truth, beside),
    ):
        known += [(f"{name}_x", poses[:, 0], 3), (f"{name}_y", poses[:, 1], 3)]
        known += [(f"{name}_heading", angles, 2)]
    return {name: column(values, digits) for name, values, digits in known if _some(values)}


def pose_errors(report: RunReport) -> Values:
    """(n,) position error in m of each pose, nan where unknown.

    With a true trajectory the error after alignment.  With relations the largest error of those
    that end at the pose, or of the nearest pose in time that has one.
    """
    trajectory = report.run.trajectory
    errors = np.full(len(trajectory), np.nan)
    if report.errors is not None:
        errors[report.errors.rows] = report.errors.trans_m
    elif report.relations is not None and len(report.relations.trans_m):
        ends, _ = nearest_rows(trajectory.stamps_ns, report.relations.at_ns, MATCH_TOLERANCE_S)
        np.fmax.at(errors, ends, report.relations.trans_m)
        known = np.flatnonzero(np.isfinite(errors))
        nearest, near = nearest_rows(
            trajectory.stamps_ns[known], trajectory.stamps_ns, _RELATION_REACH_S
        )
        errors = np.where(near, errors[known[nearest]], np.nan)
    return errors


def keyframe_columns(report: RunReport) -> dict[str, Any]:
    """Time, pose, T_PE and reason of each keyframe that the finished graph holds."""
    keyframes = report.run.keyframes
    if keyframes is None or len(keyframes) == 0:
        return {}
    decided = {d.stamp_ns: d for d in report.run.records.decisions}
    found = [decided.get(stamp) for stamp in keyframes.stamps_ns.tolist()]
    reasons = [d.reason + (f", {d.axis}" if d.axis else "") if d else "" for d in found]
    words = sorted(set(reasons))
    at_s = (keyframes.stamps_ns - report.run.trajectory.stamps_ns[0]) / NS
    t_pe = np.array([d.t_pe if d else math.nan for d in found])
    return {
        "t": column(at_s, 3),
        "x": column(keyframes.poses[:, 0], 3),
        "y": column(keyframes.poses[:, 1], 3),
        "heading": column(np.degrees(keyframes.poses[:, 2]), 3),
        "t_pe": column(t_pe, 3),
        "reasons": words,
        "reason": [words.index(reason) for reason in reasons],
    }


def _some(values: Values) -> bool:
    return bool(np.isfinite(values).any())


def _continuous(poses: Poses) -> Values:
    """Headings in degrees without jumps; nan stays where it is."""
    heading, good = np.degrees(poses[:, 2]), np.isfinite(poses[:, 2])
    heading[good] = np.unwrap(heading[good], period=360.0)
    return heading


def _speed(path: Trajectory) -> Values:
    """Metres per second, each over a window about the pose; nan of a run too short for it."""
    t = path.seconds()
    ends = [np.clip(t + shift, 0.0, t[-1]) for shift in (-_SPEED_WINDOW_S / 2, _SPEED_WINDOW_S / 2)]
    x, y = (np.interp(ends[1], t, v) - np.interp(ends[0], t, v) for v in path.poses[:, :2].T)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.hypot(x, y) / (ends[1] - ends[0]))


def _sigmas(estimates: tuple[PoseEstimate, ...], path: Trajectory) -> Values:
    """(n, 2) of position (m) and heading (degrees), as claimed on the way."""
    sigmas = np.full((len(path), 2), np.nan)
    claimed = {e.stamp_ns: e.covariance for e in estimates if len(e.covariance) == 9}
    for row, stamp in enumerate(path.stamps_ns.tolist()):
        if (c := claimed.get(stamp)) is not None and min(c[0], c[4], c[8]) >= 0.0:
            sigmas[row] = math.sqrt(c[0] + c[4]), math.degrees(math.sqrt(c[8]))
    return sigmas


def _odometry(report: RunReport, path: Trajectory) -> Poses:
    """(n, 3) where odometry had the robot, moved so that both start at one pose."""
    odometry = report.run.odometry
    if odometry is None or len(odometry) == 0:
        return np.full((len(path), 3), np.nan)
    at, wanted = odometry.seconds(), (path.stamps_ns - odometry.stamps_ns[0]) / NS
    columns = (odometry.poses[:, 0], odometry.poses[:, 1], np.unwrap(odometry.poses[:, 2]))
    poses = np.stack([np.interp(wanted, at, c, np.nan, np.nan) for c in columns], axis=-1)
    inside = np.flatnonzero(np.isfinite(poses[:, 0]))
    if len(inside) == 0:
        return poses
    first = inside[0]
    return compose(path.poses[first], between(poses[first], poses))


def _truth(report: RunReport) -> Poses:
    poses = np.full((len(report.run.trajectory), 3), np.nan)
    if report.errors is not None:
        poses[report.errors.rows] = report.errors.truth_in_map
    return poses
