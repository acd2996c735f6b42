"""Draws method.png: what SDP-PE reads from a scan, and what a match knows in a plain corridor.

Run from the project's folder: `python docs/figures.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gtsam import Pose2
from matplotlib.figure import Figure
from numpy.typing import NDArray
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.frontend.complexity import wall_profiles
from slam.frontend.keyframes import KeyframeConfig, interval_after
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import VALID, PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose

from slam.mapping.odometry import OdometryConfig

Array = NDArray[np.float64]


def scans_of(world: str) -> tuple[list[PreparedScan], list[Pose2]]:
    """Prepared scans of a simulated drive and the true poses at them."""
    messages = list(simulate(scenario(world, 1), seed=1))
    extrinsics = next(m for m in messages if isinstance(m, LaserExtrinsics))
    truth = {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in messages if isinstance(m, TruePose)}
    scans = [m for m in messages if isinstance(m, LaserScan)]
    prepared = [prepare(scan, extrinsics, ScanConfig()) for scan in scans]
    return prepared, [truth[scan.stamp_ns] for scan in scans]


def ellipse(covariance: Array, sigmas: float) -> Array:
    """(100, 2) outline of a covariance of x and y."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    outline: Array = sigmas * circle @ np.linalg.cholesky(covariance).T
    return outline


def main() -> None:
    """Draw both panels."""
    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    bed, corridor = figure.subplots(1, 2)
    scans, _ = scans_of("testbed")
    scan, config = scans[len(scans) // 2], KeyframeConfig(method="sdp-pe")
    seen = scan.points[(scan.flags & VALID) > 0]
    bed.plot(seen[:, 0], seen[:, 1], "k.", ms=3)
    profiles = wall_profiles(scan.points, config.profile_reach, config.profile_bin)
    for depth, side, name in zip(profiles, (1.0, -1.0), ("left", "right"), strict=True):
        edges = (np.arange(len(depth) + 1) - 0.5 * len(depth)) * config.profile_bin
        bed.stairs(side * depth, edges, baseline=None, lw=2, alpha=0.7, label=f"{name} profile")
    found = interval_after(scan, config)
    bed.plot(0.0, 0.0, ">", color="tab:red", ms=9)
    bed.set_title(f"next keyframe after {found.length:.2f} m", fontsize=10)
    bed.set_xlim(-0.5, config.profile_reach)
    bed.set_ylim(-1.8, 1.8)
    bed.legend(fontsize=8, loc="lower right", ncols=2)

    scans, truth = scans_of("plain-corridor")
    first, later = len(scans) // 2, len(scans) // 2 + 10
    moved = truth[first].between(truth[later])
    prior = Prior(moved, OdometryConfig().covariance(moved.x(), abs(moved.theta()), 1.0))
    alone = match([Reference(Pose2(), scans[first])], scans[later], moved, MatchConfig(), prior)
    information = alone.information + 1e-6 * np.eye(3)
    for matrix, colour, label in (
        (np.linalg.inv(information), "tab:blue", "scans alone"),
        (np.linalg.inv(information + np.linalg.inv(prior.covariance)), "tab:orange",
         "with odometry"),
    ):  # fmt: skip
        outline = 100.0 * ellipse(matrix[:2, :2], 3.0)
        corridor.plot(outline[:, 0], outline[:, 1], color=colour, label=label)
    corridor.set_xlim(-40.0, 40.0)
    corridor.set_ylim(-2.0, 2.0)
    corridor.set_title("3 sigma of one match in a plain corridor", fontsize=10)
    corridor.set_xlabel("along [cm]")
    corridor.set_ylabel("across [cm]")
    corridor.legend(fontsize=8)
    bed.set_xlabel("x, forward [m]")
    bed.set_ylabel("y, left [m]")
    for axes in (bed, corridor):
        axes.grid(alpha=0.3)
    figure.savefig(Path(__file__).parent / "method.png", dpi=110)


if __name__ == "__main__":
    main()
