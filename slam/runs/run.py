"""`slam.replay` and the `Run` that it returns, for programs and notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.batch_optimisation import FactorMaker, values_of
from slam.logs.messages import OccupancyMap
from slam.logs.trajectory import Trajectory
from slam.mapping.config import SlamConfig
from slam.runs.config_file import load_config, settings_as_overrides
from slam.runs.replay import FinishedRun, run_log
from slam.runs.run_directory import new_run
from slam.runs.thread_pool import thread_count

POSE_COLUMNS = [("stamp_ns", np.int64), ("x", float), ("y", float), ("theta", float)]


class Run:
    """A mapped log.  Poses are map_T_base, in m, m and rad; stamps are ns of UTC."""

    def __init__(self, finished: FinishedRun) -> None:
        self.finished = finished

    @property
    def config(self) -> SlamConfig:
        """The settings that were in force."""
        return self.finished.config

    @property
    def trajectory(self) -> NDArray[np.void]:
        """(n,) one row for every scan, with columns `stamp_ns`, `x`, `y`, `theta`."""
        return pose_table(self.finished.result.trajectory)

    @property
    def keyframes(self) -> NDArray[np.void]:
        """(k,) the same columns for every keyframe."""
        return pose_table(self.finished.result.keyframes)

    @property
    def odometry(self) -> NDArray[np.void]:
        """(n,) the same columns, odom_T_base by the wheels alone."""
        return pose_table(self.finished.result.odometry)

    @property
    def covariances(self) -> NDArray[np.float64]:
        """(n, 3, 3) of every scan's pose, of (x, y, theta) in its own frame: m^2, m rad, rad^2."""
        flat = [estimate.covariance for estimate in self.finished.result.estimates]
        return np.array(flat, dtype=np.float64).reshape(-1, 3, 3)

    @property
    def map(self) -> OccupancyMap:
        """The occupancy grid: `cells` (rows, columns) in percent, -1 unknown, and where it lies."""
        return self.finished.result.grid

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The factor graph as it was optimised, with its robust kernels; key X(k) is keyframe k."""
        result = self.finished.result
        first = Pose2(*result.keyframes.poses[0])
        return FactorMaker(self.config.graph).graph(first, result.edges, robust=True)

    @property
    def values(self) -> gtsam.Values:
        """The optimised poses of the keyframes, for `graph`."""
        return values_of(self.finished.result.keyframes.poses)

    @property
    def summary(self) -> dict[str, Any]:
        """Counts, timing and losses, as in `summary.json`."""
        return self.finished.summary()

    def save(self, directory: str | Path) -> Path:
        """Write a RUN directory, as `slam replay --out` does.

        Raises:
            RunError: the directory exists already, or cannot be written.
        """
        out = Path(directory)
        with new_run(out) as partial:
            self.finished.write(partial)
        return out

    def __repr__(self) -> str:
        result = self.finished.result
        closures = sum(edge.kind == "loop" for edge in result.edges)
        return (
            f"<Run of {self.finished.log}: {len(result.trajectory)} scans, "
            f"{len(result.keyframes)} keyframes, {closures} loop closures>"
        )


def replay(
    log: str | Path,
    *,
    out: str | Path | None = None,
    config: str | Path | SlamConfig | None = None,
    set: Mapping[str, Any] | None = None,
    threads: int | None = None,
) -> Run:
    """Map a recording, as the command `slam replay` does.

    Args:
        log: an MCAP log with `/scan` and `/odom`.
        out: RUN directory to write; None writes nothing.
        config: a TOML file or a configuration; None takes the defaults.
        set: settings that win over the configuration, such as `{"loops.enabled": False}`.
        threads: to place the scans with in the end; None takes one for each core, 4 at most.  The
            result is the same for any number.

    Raises:
        LogError: the log cannot be read.
        ConfigError: a setting is unknown or out of range.
        SlamError: the log holds nothing to map.
        RunError: `out` exists already, or cannot be written.
    """
    settings = _settings(config, set or {})
    workers = thread_count() if threads is None else threads
    if out is None:
        return Run(run_log(Path(log), settings, threads=workers))
    with new_run(Path(out)) as partial:
        finished = run_log(Path(log), settings, threads=workers)
        finished.write(partial)
    return Run(finished)


def pose_table(trajectory: Trajectory) -> NDArray[np.void]:
    """(n,) poses of a trajectory with named columns."""
    table = np.empty(len(trajectory), dtype=POSE_COLUMNS)
    table["stamp_ns"] = trajectory.stamps_ns
    for column, name in enumerate(("x", "y", "theta")):
        table[name] = trajectory.poses[:, column]
    return table


def _settings(config: str | Path | SlamConfig | None, overrides: Mapping[str, Any]) -> SlamConfig:
    if isinstance(config, SlamConfig):
        return load_config(None, settings_as_overrides(overrides), base=config)
    path = None if config is None else Path(config)
    return load_config(path, settings_as_overrides(overrides))
