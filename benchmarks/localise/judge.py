"""Poses of a localiser against the true ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.logs.messages import LaserExtrinsics, LaserScan, Message

from slam.mapping.config import SlamConfig
from slam.mapping.localisation.evidence import WRONG_M, WRONG_RAD
from slam.mapping.localisation.localiser import Localised, Localiser
from slam.mapping.relocalise import PriorMap

Matrix = NDArray[np.float64]
Truth = Mapping[int, Pose2]  # map_T_base by stamp (ns)

# Inside the map: a keyframe stood so near by and looked the same way, so that the map shows what
# the robot sees.
INSIDE_M, INSIDE_RAD = 1.0, np.radians(45.0)
START_M, START_S = 5.0, 60.0  # m of driving, and s, after which a start has failed


def located(messages: Iterable[Message], config: SlamConfig, prior: PriorMap) -> list[Localised]:
    """Every scan of a drive."""
    localiser = Localiser(config, prior)
    found = [scan for message in messages for scan in localiser.step(message)]
    return [*found, *localiser.finish()]


def errors(found: Sequence[Localised], truth: Truth) -> Matrix:
    """(n, 2) m and rad by which each scan's pose is off; inf where there is none."""
    rows = []
    for scan in found:
        if scan.map_T_base is None:
            rows.append((np.inf, np.inf))
            continue
        error = truth[scan.stamp_ns].between(scan.map_T_base)
        rows.append((float(np.hypot(error.x(), error.y())), abs(error.theta())))
    return np.array(rows).reshape(-1, 2)


def is_wrong(off: Matrix) -> NDArray[np.bool_]:
    """Which of the errors (n, 2) are those of wrong poses."""
    wrong: NDArray[np.bool_] = (off[:, 0] > WRONG_M) | (off[:, 1] > WRONG_RAD)
    return wrong


def inside(found: Sequence[Localised], truth: Truth, keyframes: Matrix) -> NDArray[np.bool_]:
    """Which scans were taken inside a map of keyframes (m, 3)."""
    at = np.array([[p.x(), p.y(), p.theta()] for p in (truth[s.stamp_ns] for s in found)])
    return np.array([is_inside(pose, keyframes) for pose in at])


def is_inside(pose: Matrix, keyframes: Matrix) -> bool:
    """Whether a pose (3,) is inside the map."""
    near = np.hypot(*(keyframes[:, :2] - pose[:2]).T) < INSIDE_M
    turn = np.abs(np.angle(np.exp(1j * (keyframes[near, 2] - pose[2]))))
    return bool((turn < INSIDE_RAD).any())


def track_row(found: Sequence[Localised], truth: Truth, keyframes: Matrix) -> dict[str, Any]:
    """Figures of a drive."""
    off, lost = errors(found, truth), np.array([s.lost for s in found])
    within = inside(found, truth, keyframes)
    used = off[~lost & within]
    return {
        "scans": len(found),
        "inside": float(within.mean()),
        "lost_inside": float(lost[within].mean()) if within.any() else None,
        "median_cm": 100.0 * float(np.median(used[:, 0])) if len(used) else None,
        "median_deg": float(np.degrees(np.median(used[:, 1]))) if len(used) else None,
        "wrong_not_lost": float((is_wrong(off) & ~lost).mean()),
    }


def start_from(
    messages: Sequence[Message], first_ns: int, truth: Truth, config: SlamConfig, prior: PriorMap
) -> dict[str, Any]:
    """Switch the localiser on at a stamp, with nothing known; what it says first, and when."""
    localiser = Localiser(config, prior)
    began, before, way = first_ns, None, 0.0
    for message in messages:
        if message.stamp_ns < first_ns and not isinstance(message, LaserExtrinsics):
            continue
        for scan in localiser.step(message):
            at = truth[scan.stamp_ns]
            way += 0.0 if before is None else float(np.hypot(*(at.translation() - before)))
            before = at.translation()
            seconds = (scan.stamp_ns - began) * 1e-9
            if not scan.lost:
                wrong = bool(is_wrong(errors([scan], truth))[0])
                return {"found": not wrong, "wrong": wrong, "way_m": way, "seconds": seconds}
            if way > START_M or seconds > START_S:
                return {"found": False, "wrong": False, "way_m": way, "seconds": seconds}
    return {"found": False, "wrong": False, "way_m": way, "seconds": 0.0}


def starts_row(starts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Figures of many starts from nothing."""
    found = [start for start in starts if start["found"]]
    return {
        "starts": len(starts),
        "starts_found": len(found),
        "starts_wrong": sum(start["wrong"] for start in starts),
        "start_way_m": float(np.median([s["way_m"] for s in found])) if found else None,
    }


def scan_stamps(messages: Iterable[Message]) -> list[int]:
    """Stamps of all scans."""
    return [m.stamp_ns for m in messages if isinstance(m, LaserScan)]
