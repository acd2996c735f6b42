"""`slam localise`: a log and a finished RUN in, the robot's poses in that map out."""

from __future__ import annotations

import math
import platform
import time
from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slam.backend.se2 import between, compose
from slam.logs.check_clocks import refuse_clocks_apart
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import FrameTransform, LaserExtrinsics, Message, PoseEstimate, TruePose
from slam.logs.parts import Recording
from slam.logs.trajectory import Trajectory, format_stamp, path_length, write_tum
from slam.mapping.config import SlamConfig
from slam.mapping.localisation.localiser import Localised, Localiser
from slam.mapping.message_checks import validate_message
from slam.maps.map_picture import write_map_png
from slam.maps.nav2_map import read_nav2_map, write_nav2_map
from slam.runs.errors import SlamError
from slam.runs.kernel_warmup.second_process import compiled
from slam.runs.kernel_warmup.warmup import warm_up
from slam.runs.machine import peak_memory_mb
from slam.runs.offline import Progress
from slam.runs.replay import SLAM_TOPICS, file_sha256
from slam.runs.resume import read_prior_map
from slam.runs.run_directory import new_run, version, write_summary

NO_POSE = (math.nan, math.nan, math.nan)


@dataclass(eq=False)
class LocalisedRun:
    """What is kept of every scan: numbers alone, 200 bytes each."""

    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    odometry: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta
    poses: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta; nan if none
    covariances: array[float] = field(default_factory=lambda: array("d"))  # 9 each
    wrong: array[float] = field(default_factory=lambda: array("d"))  # probability
    lost: array[int] = field(default_factory=lambda: array("b"))
    hypotheses: array[int] = field(default_factory=lambda: array("i"))
    rivals: array[int] = field(default_factory=lambda: array("i"))
    milliseconds: array[float] = field(default_factory=lambda: array("d"))  # of each message
    truth: list[TruePose] = field(default_factory=list)
    extrinsics: LaserExtrinsics | None = None
    left_out: Counter[str] = field(default_factory=Counter)  # data without use, per cause
    searches: int = 0
    times_lost: int = 0

    def add(self, scan: Localised) -> None:
        """Append a scan."""
        self.stamps_ns.append(scan.stamp_ns)
        odom, pose = scan.odom_T_base, scan.map_T_base
        self.odometry.extend((odom.x(), odom.y(), odom.theta()))
        self.poses.extend(NO_POSE if pose is None else (pose.x(), pose.y(), pose.theta()))
        self.covariances.extend(scan.covariance.ravel().tolist())
        self.wrong.append(scan.wrong)
        self.lost.append(scan.lost)
        self.hypotheses.append(scan.hypotheses)
        self.rivals.append(scan.rivals)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def all_odometry(self) -> Trajectory:
        """odom_T_base at every scan."""
        return Trajectory(_stamps(self.stamps_ns), np.array(self.odometry).reshape(-1, 3))

    @property
    def trajectory(self) -> Trajectory:
        """map_T_base at the scans where the robot was not lost."""
        rows = np.flatnonzero(np.array(self.lost, dtype=np.int8) == 0)
        poses = np.array(self.poses).reshape(-1, 3)
        return Trajectory(_stamps(self.stamps_ns)[rows], poses[rows])

    @property
    def lost_share(self) -> float:
        """Share of the time in which the robot was lost."""
        if len(self) < 2:
            return float(any(self.lost))
        steps = np.diff(_stamps(self.stamps_ns))
        lost = np.array(self.lost, dtype=bool)[1:]
        return float(steps[lost].sum() / steps.sum())


def _stamps(stamps_ns: array[int]) -> np.ndarray[Any, np.dtype[np.int64]]:
    return np.array(stamps_ns, dtype=np.int64)


def localise_messages(
    messages: Iterable[Message], localiser: Localiser, progress: Progress | None = None
) -> LocalisedRun:
    """Hand all messages to a localiser.

    Raises:
        SlamError: there is no scan among them.
    """
    run = LocalisedRun()
    for count, message in enumerate(messages, start=1):
        if cause := validate_message(message):
            run.left_out[cause] += 1
            continue
        if isinstance(message, TruePose):
            run.truth.append(message)
        begin = time.perf_counter()
        for scan in localiser.step(message):
            run.add(scan)
        run.milliseconds.append((time.perf_counter() - begin) * 1e3)
        if progress is not None:
            progress("tracking", count)
    for scan in localiser.finish():
        run.add(scan)
    if not len(run):
        raise SlamError("no usable scan: the log must hold scans")
    run.left_out.update(localiser.feed.lost)
    run.extrinsics = localiser.feed.extrinsics
    run.searches, run.times_lost = localiser.searches, localiser.times_lost
    return run


def localise(
    log: Path, prior: Path, out: Path, config: SlamConfig, start: str = "",
    progress: Progress | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Localise a log in the map of the RUN `prior`, and write a RUN directory; its summary.

    Args:
        log: the recording.
        prior: the finished RUN; it is only read.
        out: the directory to make.
        config: of the run.
        start: where the robot starts, as `read_prior_map` takes it; found by itself if empty.
        progress: called with the stage and how far it is.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no usable scan.
        RunError: `prior` is no finished run, or the output cannot be written.
    """
    with new_run(out) as partial:
        prior_map = read_prior_map(prior, config, start)
        recording = Recording(log)
        sha256 = file_sha256(*recording.files)
        if recording.counts().get("/odom"):
            refuse_clocks_apart(log.name, recording.receipts(("/scan", "/odom")))
        if not compiled():
            if progress is not None:
                progress("compiling", 0)
            warm_up(config)
        begin = time.perf_counter()
        run = localise_messages(
            recording.messages(SLAM_TOPICS), Localiser(config, prior_map), progress
        )
        wall = time.perf_counter() - begin
        run.left_out.update(recording.skipped)
        identity = {
            "source": log.name, "source_sha256": sha256, "version": version(),
            "config_sha256": config.sha256(), "host": platform.node(), "map": prior.name,
        }  # fmt: skip
        _write(partial, run, prior, identity, config)
        summary = {"log": log.name, "map": prior.name, **_summary(run, wall)}
        summary |= {
            "version": version(), "config_sha256": config.sha256(), "log_sha256": sha256,
            "host": platform.node(),
        }  # fmt: skip
        write_summary(partial, summary)
        return summary


def _summary(run: LocalisedRun, wall: float) -> dict[str, Any]:
    trajectory, stamps = run.trajectory, _stamps(run.stamps_ns)
    duration = float(stamps[-1] - stamps[0]) * 1e-9
    way = path_length(run.all_odometry.poses)
    found = np.flatnonzero(np.array(run.lost) == 0)
    steps = np.array(run.milliseconds)
    return {
        "scans": len(run),
        "localised_scans": len(trajectory),
        "duration_s": round(duration, 3),
        "distance_m": round(float(way[-1]), 3),
        "lost_share": round(run.lost_share, 4),
        "times_lost": run.times_lost,
        "ended_lost": bool(run.lost[-1]),
        "wrong_at_end": round(run.wrong[-1], 4),
        "rivals_at_end": run.rivals[-1],
        "ambiguous_share": round(float(np.mean(np.array(run.rivals) > 0)), 4),
        "found_after_m": round(float(way[found[0]]), 3) if len(found) else None,
        "found_after_s": round(float(stamps[found[0]] - stamps[0]) * 1e-9, 3)
        if len(found)
        else None,
        "searches": run.searches,
        "timing": {
            "wall_s": round(wall, 3),
            "realtime_factor": round(duration / wall, 2),
            "step_ms_p50": round(float(np.percentile(steps, 50)), 4),
            "step_ms_p99": round(float(np.percentile(steps, 99)), 4),
            "step_ms_max": round(float(steps.max()), 4),
        },
        "peak_rss_mb": peak_memory_mb(),
        "lost": dict(sorted(run.left_out.items())),
    }


def _write(
    directory: Path, run: LocalisedRun, prior: Path, identity: dict[str, str], config: SlamConfig
) -> None:
    """All files but the summary; deterministic but for the identity."""
    trajectory = run.trajectory
    write_tum(directory / "trajectory.tum", trajectory)
    write_tum(directory / "odometry.tum", run.all_odometry)
    _write_csv(directory / "localisation.csv", run)
    grid = read_nav2_map(prior)
    write_nav2_map(directory, grid)
    write_map_png(directory / "map.png", grid, trajectory)
    never = math.inf
    with LogWriter(
        directory / "run.mcap", identity, sync_period_s=never, keep_partial=False
    ) as log:
        settings = config.model_dump_json(indent=2).encode()
        log.add_attachment("config.json", settings, "application/json")
        if run.extrinsics is not None:
            log.write(run.extrinsics)
        for truth in run.truth:
            log.write(truth)
        for message in _estimates(run):
            log.write(message)


def _estimates(run: LocalisedRun) -> Iterable[Message]:
    """Where the robot is at every scan that has a pose, and the frames for viewers."""
    poses, odometry = np.array(run.poses).reshape(-1, 3), np.array(run.odometry).reshape(-1, 3)
    covariances = np.array(run.covariances).reshape(-1, 9)
    map_T_odom = compose(poses, between(odometry, np.zeros((1, 3))))
    for k in np.flatnonzero(np.isfinite(poses[:, 0])).tolist():
        stamp = run.stamps_ns[k]
        x, y, theta = poses[k].tolist()
        yield PoseEstimate(stamp, x, y, theta, tuple(covariances[k].tolist()), bool(run.lost[k]))
        yield FrameTransform(stamp, "map", "odom", *map_T_odom[k].tolist())
        yield FrameTransform(stamp, "odom", "base", *odometry[k].tolist())


def _write_csv(path: Path, run: LocalisedRun) -> None:
    """Every scan, with what is known of how sure its pose is."""
    rows = ["stamp_s,x,y,theta,wrong,lost,hypotheses,rivals"]
    for k, stamp in enumerate(run.stamps_ns):
        x, y, theta = run.poses[3 * k : 3 * k + 3]
        rows.append(
            f"{format_stamp(stamp)},{x!r},{y!r},{theta!r},{run.wrong[k]:.6f},{run.lost[k]},"
            f"{run.hypotheses[k]},{run.rivals[k]}"
        )
    path.write_text("\n".join(rows) + "\n", encoding="ascii")
