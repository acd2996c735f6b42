"""The paper's named alternatives to point-to-line ICP, from a guess to a pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.match_types import TOLERANCE_M, MatchConfig, Reference
from slam.frontend.ndt import build_cells, ndt
from slam.frontend.point_to_point import point_to_point
from slam.frontend.psm import psm
from slam.frontend.scan import VALID, PreparedScan

Matrix = NDArray[np.float64]

POINT_GATE_M = 0.5  # pairing distance of point_to_point
NDT_CELL_M = 1.0  # cell of ndt, as in Biber and Strasser 2003


def find_pose(
    references: Sequence[Reference],
    stack: tuple[Any, ...],
    source: PreparedScan,
    guess: Matrix,
    config: MatchConfig,
) -> tuple[Matrix, float, int]:
    """Pose (3,) by `config.method`, the size of its last step (m), and the iterations."""
    pose = guess.copy()
    if config.method == "point_to_point":
        size, count = point_to_point(
            source.points, source.flags, stack, pose, POINT_GATE_M, 2 * config.iterations,
            TOLERANCE_M,
        )  # fmt: skip
    elif config.method == "ndt":
        cloud = np.concatenate([placed(r.target_T_scan, r.scan) for r in references])
        cells, origin, shape = build_cells(cloud, NDT_CELL_M)
        valid = source.points[(source.flags & VALID) > 0]
        size, count = ndt(
            cells, origin, shape, NDT_CELL_M, valid, pose, 2 * config.iterations,
            TOLERANCE_M,
        )  # fmt: skip
    else:
        pose, size, count = _match_polar(references, source, pose, config)
    return pose, float(size), int(count)


def placed(target_T_scan: Pose2, scan: PreparedScan) -> Matrix:
    """Valid points of a scan in the target frame, (n, 2)."""
    points = scan.points[(scan.flags & VALID) > 0]
    return np.ascontiguousarray(target_T_scan.transformFrom(np.asfortranarray(points.T)).T)


def _match_polar(
    references: Sequence[Reference], source: PreparedScan, pose: Matrix, config: MatchConfig
) -> tuple[Matrix, float, int]:
    """PSM compares two scans only: the reference nearest to the guess is taken."""
    nearest = min(
        references,
        key=lambda r: np.hypot(r.target_T_scan.x() - pose[0], r.target_T_scan.y() - pose[1]),
    )
    scan_T_source = nearest.target_T_scan.between(Pose2(*pose))
    local = np.array([scan_T_source.x(), scan_T_source.y(), scan_T_source.theta()])
    size, count = psm(
        source.points, source.flags, nearest.scan.ranges, nearest.scan.geometry, local,
        3 * config.iterations, TOLERANCE_M,
    )  # fmt: skip
    found = nearest.target_T_scan * Pose2(*local)
    return np.array([found.x(), found.y(), found.theta()]), size, count
