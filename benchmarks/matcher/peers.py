"""Our matchers and the libraries that they are measured against, behind one shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from scipy.spatial import KDTree
from slam.frontend.match_types import MatchConfig, Method, Reference
from slam.frontend.matching import match
from slam.frontend.scan import VALID, PreparedScan, ScanConfig, prepare

from benchmarks.matcher.pairs import CENTRED, Pair
from slam.runs.errors import RunError

Array = NDArray[np.float64]

OURS: tuple[Method, ...] = ("point_to_line", "point_to_point", "ndt", "psm")
HEIGHTS = (-0.2, -0.1, 0.0, 0.1, 0.2)  # m, of the copies that give flat points normals in 3D
REACH = 0.5  # m, pairing distance of the libraries: their errors are least with it
FAR_REACH = 1.0  # m, the same from far guesses
UNTHINNED = 1e-3  # m, voxels that leave every point
NEIGHBOURS = 10  # small_gicp's own number for covariances


class BenchError(RunError):
    """A benchmark lacks something that it needs; the message says what to install or fetch."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A matcher in two calls: what can be done once a scan, and the match itself."""

    name: str
    build: Callable[[Pair], Any]  # indices, normals, trees
    align: Callable[[Any, Pose2, float], Pose2]  # built parts, guess, reach (m)
    whole: Callable[[Pair, Pose2], Pose2]  # both, from points (libraries) or ranges (ours)


def all_peers() -> list[Peer]:
    """Our four methods, small_gicp's two, and ICP on SciPy's tree.

    Raises:
        BenchError: if small_gicp is not installed.
    """
    try:
        import small_gicp
    except ImportError as error:
        raise BenchError(
            "small_gicp is not installed: pip install small-gicp, or the extra `bench`"
        ) from error
    gicp = [_gicp_peer(small_gicp, "ICP"), _gicp_peer(small_gicp, "GICP")]
    scipy = Peer("scipy_icp", _scipy_build, _scipy_align, _scipy_whole)
    return [*(_our_peer(method) for method in OURS), *gicp, scipy]


def _our_peer(method: Method) -> Peer:
    config, scan_config = MatchConfig(method=method), ScanConfig()

    def align(built: Any, guess: Pose2, reach: float) -> Pose2:
        target, source = built
        return match([Reference(Pose2(), target)], source, guess, config).target_T_source

    def whole(pair: Pair, guess: Pose2) -> Pose2:
        scans = [prepare(scan, CENTRED, scan_config) for scan in pair.raw]
        return align(scans, guess, REACH)

    return Peer(method, lambda pair: (pair.target, pair.source), align, whole)


def _flat(scan: PreparedScan) -> Array:
    points: Array = scan.points[(scan.flags & VALID) > 0]
    return points


def _raised(scan: PreparedScan, heights: tuple[float, ...]) -> Array:
    """Points (n * heights, 3) at each of the heights."""
    flat = _flat(scan)
    return np.vstack([np.column_stack([flat, np.full(len(flat), z)]) for z in heights])


def _gicp_peer(small_gicp: Any, kind: str) -> Peer:
    heights = HEIGHTS if kind == "GICP" else (0.0,)

    def build(pair: Pair) -> Any:
        target = small_gicp.PointCloud(_raised(pair.target, heights))
        source = small_gicp.PointCloud(_raised(pair.source, heights))
        tree = small_gicp.KdTree(target)
        if kind == "GICP":
            small_gicp.estimate_covariances(target, tree, num_neighbors=NEIGHBOURS)
            small_gicp.estimate_covariances(source, num_neighbors=NEIGHBOURS)
        return target, source, tree

    def align(built: Any, guess: Pose2, reach: float) -> Pose2:
        target, source, tree = built
        result = small_gicp.align(
            target, source, tree, _matrix(guess), registration_type=kind,
            max_correspondence_distance=reach, num_threads=1,
        )  # fmt: skip
        return _pose(result.T_target_source)

    def whole(pair: Pair, guess: Pose2) -> Pose2:
        result = small_gicp.align(
            _raised(pair.target, heights), _raised(pair.source, heights), _matrix(guess),
            registration_type=kind, downsampling_resolution=UNTHINNED,
            max_correspondence_distance=REACH, num_threads=1,
        )  # fmt: skip
        return _pose(result.T_target_source)

    return Peer(f"small_gicp_{kind.lower()}", build, align, whole)


def _matrix(pose: Pose2) -> Array:
    """(4, 4): the pose in the plane z = 0."""
    out = np.eye(4)
    c, s = np.cos(pose.theta()), np.sin(pose.theta())
    out[:2, :2] = [[c, -s], [s, c]]
    out[:2, 3] = pose.x(), pose.y()
    return out


def _pose(matrix: Array) -> Pose2:
    turn = np.arctan2(matrix[1, 0], matrix[0, 0])
    return Pose2(float(matrix[0, 3]), float(matrix[1, 3]), float(turn))


def _scipy_build(pair: Pair) -> Any:
    target = _flat(pair.target)
    return KDTree(target), target, _flat(pair.source)


def _scipy_align(built: Any, guess: Pose2, reach: float) -> Pose2:
    """Point-to-point ICP in closed form (Besl and McKay 1992) on SciPy's k-d tree."""
    tree, target, source = built
    pose = guess
    for _ in range(50):
        c, s = np.cos(pose.theta()), np.sin(pose.theta())
        moved = source @ np.array([[c, s], [-s, c]]) + [pose.x(), pose.y()]
        distances, nearest = tree.query(moved, distance_upper_bound=reach)
        paired = np.isfinite(distances)
        if paired.sum() < 3:
            break
        p, q = moved[paired], target[nearest[paired]]
        p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
        a, b = p - p_mean, q - q_mean
        turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
        c, s = np.cos(turn), np.sin(turn)
        x, y = q_mean - np.array([c * p_mean[0] - s * p_mean[1], s * p_mean[0] + c * p_mean[1]])
        pose = Pose2(x, y, turn) * pose
        if np.abs([x, y]).sum() + 5.0 * abs(turn) < 1e-3:  # small_gicp's own tolerance
            break
    return pose


def _scipy_whole(pair: Pair, guess: Pose2) -> Pose2:
    return _scipy_align(_scipy_build(pair), guess, REACH)
