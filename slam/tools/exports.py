"""`slam export`: a log, or a RUN, in the formats of other programs.

The log of a RUN holds its results behind its input.  For formats in which order matters they
are put in order of time, with the odometry of `odometry.tum` at every scan, so that a
transform from map to odom belongs to the odometry of the same moment.
"""

from __future__ import annotations

import heapq
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from slam.logs.atomic_write import atomic_path
from slam.logs.exporters.carmen import write_carmen
from slam.logs.exporters.csv import write_csv
from slam.logs.exporters.ros2 import write_ros2
from slam.logs.messages import Message, TruePose, WheelOdometry
from slam.logs.parts import Recording
from slam.logs.trajectory import Trajectory, read_tum, sorted_trajectory, write_tum
from slam.mapping.message_checks import validate_message
from slam.runs.errors import RunError

LOG_POSES = {"odometry": "/odom", "truth": "/truth"}
RUN_POSES = ("trajectory", "keyframes", "odometry")
_CARMEN_TOPICS = ("/scan", "/odom", "/tf")
_ROS_TOPICS = ("/scan", "/odom", "/tf", "/truth", "/pose", "/map", "/log", "/diagnostics")
_RUN_LOG = "run.mcap"

_Received = tuple[int | None, Message]


@dataclass(slots=True)
class Exported:
    """What was written, and what could not be."""

    written: list[str] = field(default_factory=list)  # in words
    lost: dict[str, int] = field(default_factory=dict)  # of the log, per cause

    def note(self, path: Path, what: str) -> None:
        """Note a file that was written."""
        self.written.append(f"{path}: {what}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Targets:
    """What to write; None: not asked for.  `poses` are those of `tum`, empty: the usual ones."""

    carmen: Path | None = None
    ros2: Path | None = None
    csv: Path | None = None
    tum: Path | None = None
    g2o: Path | None = None
    poses: str = ""

    def paths(self) -> list[Path]:
        """All that is asked for."""
        named = (self.carmen, self.ros2, self.csv, self.tum, self.g2o)
        return [path for path in named if path is not None]


def export(source: Path, targets: Targets) -> Exported:
    """Write a log or a RUN in every format asked for.

    Raises:
        LogError: the log cannot be read, or a file cannot be written.
        RunError: the RUN lacks what was asked for, or a file cannot be written.
    """
    log = source / _RUN_LOG if source.is_dir() else source
    if source.is_dir() and not log.is_file():
        raise RunError(f"{source}: is no RUN: there is no {_RUN_LOG} in it")
    for path in targets.paths():
        if path.exists() and log.exists() and path.samefile(log):
            raise RunError(f"{path}: would replace the log itself: choose another name")
    for one in (targets.tum, targets.g2o):
        if one is not None and one.exists():
            raise RunError(f"{one}: exists already: choose another name, or remove it first")
    done = Exported()
    if targets.g2o:
        if log is source:
            raise RunError(f"{source}: a log has no graph: name the RUN that `slam replay` made")
        _copy(source / "graph.g2o", targets.g2o, done)
    if targets.tum:
        _export_tum(source, log, targets, done)
    if targets.carmen:
        received = _received(source, log, _CARMEN_TOPICS, done)
        scans = write_carmen(targets.carmen, (message for _, message in received))
        done.note(targets.carmen, f"{scans} scans")
    if targets.csv:
        rows = write_csv(targets.csv, _logged(log, None, done))
        done.note(targets.csv, _counts(rows))
    if targets.ros2:
        bag = write_ros2(targets.ros2, _received(source, log, _ROS_TOPICS, done))
        done.note(targets.ros2, _counts(bag.written))
        done.lost.update(bag.skipped)
    return done


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))


def _received(
    source: Path, log: Path, topics: Collection[str], done: Exported
) -> Iterator[_Received]:
    """Messages with their times of receipt, in the order that the formats need."""
    if source is log:
        yield from _logged(log, topics, done)
        return
    path = source / "odometry.tum"
    odometry = read_tum(path) if path.is_file() else sorted_trajectory([], [])
    # One pass a topic, because a RUN's log has them behind each other; odometry is the first.
    streams = [_logged(log, (topic,), done) for topic in topics if topic != "/odom"]
    for _, message in heapq.merge(_wheels(odometry), *streams, key=_stamp):
        yield None, message


def _logged(log: Path, topics: Collection[str] | None, done: Exported) -> Iterator[_Received]:
    recording = Recording(log)
    yield from recording.receipts(topics)
    done.lost.update(recording.skipped)


def _wheels(odometry: Trajectory) -> Iterator[_Received]:
    for stamp, pose in zip(odometry.stamps_ns.tolist(), odometry.poses.tolist(), strict=True):
        yield None, WheelOdometry(stamp, *pose)


def _stamp(received: _Received) -> int:
    return received[1].stamp_ns


def _export_tum(source: Path, log: Path, targets: Targets, done: Exported) -> None:
    assert targets.tum is not None
    known, usual = (LOG_POSES, "odometry") if source is log else (RUN_POSES, "trajectory")
    poses = targets.poses or usual
    if poses not in known:
        raise RunError(f"{source}: has no poses named {poses!r}: {', '.join(known)}")
    if source is not log:
        _copy(source / f"{poses}.tum", targets.tum, done)
        return
    stamps, rows = [], []
    for _, message in _logged(log, (LOG_POSES[poses],), done):
        if isinstance(message, WheelOdometry | TruePose):
            if cause := validate_message(message):
                done.lost[cause] = done.lost.get(cause, 0) + 1
                continue
            stamps.append(message.stamp_ns)
            rows.append((message.x, message.y, message.theta))
    if not rows:
        raise RunError(f"{log}: holds no {poses}: there is nothing to write")
    _write(targets.tum, lambda path: write_tum(path, sorted_trajectory(stamps, rows)))
    done.note(targets.tum, f"{len(rows)} poses of {poses}")


def _copy(source: Path, out: Path, done: Exported) -> None:
    if not source.is_file():
        raise RunError(f"{source}: is not there: the RUN has no such result")
    _write(out, lambda path: shutil.copyfile(source, path))
    done.note(out, f"copy of {source.name}")


def _write(out: Path, write: Callable[[Path], object]) -> None:
    """Write a file under another name first, so that it is there whole or not at all."""
    try:
        with atomic_path(out) as partial:
            write(partial)
    except OSError as error:
        raise RunError(f"{out}: cannot be written: {error.strerror}") from error
