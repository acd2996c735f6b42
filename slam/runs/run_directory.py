"""The RUN directory: what a run leaves behind, complete or not at all."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from slam.backend.g2o import write_g2o
from slam.logs.file_lock import hold_folder
from slam.logs.mcap_log import LogWriter, library_name
from slam.logs.trajectory import format_stamp, write_tum
from slam.maps.map_picture import write_map_png
from slam.maps.nav2_map import write_nav2_map
from slam.runs.errors import RunError
from slam.runs.offline import Result
from slam.runs.viewer_frames import maps_along_the_way, transforms


class _TakenError(Exception):
    """The directory belongs to a command that still runs."""


@contextmanager
def _claimed(partial: Path) -> Iterator[None]:
    """Make the directory, instead of what a command that was cut off has left, and lock it.

    The lock ends with the process, however that ends.  What is not ours is never removed.
    """
    if partial.exists():
        with _locked(partial):
            shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    with _locked(partial):
        try:
            yield
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise


@contextmanager
def _locked(directory: Path) -> Iterator[None]:
    try:
        handle = hold_folder(directory)
    except BlockingIOError as error:
        raise _TakenError from error
    try:
        yield
    finally:
        if handle is not None:
            os.close(handle)


@contextmanager
def new_run(out: Path) -> Iterator[Path]:
    """A `.partial` directory that takes the name `out` if the block ends well, or else is removed.

    Raises:
        RunError: `out` exists already, is being written by another command, or cannot be made.
    """
    if out.exists():
        raise RunError(f"{out}: exists already; choose another --out or remove it first")
    partial = out.with_name(out.name + ".partial")
    missing = [folder for folder in out.parents if not folder.exists()]
    try:
        with _claimed(partial):
            yield partial
            os.replace(partial, out)
    except _TakenError as error:
        raise RunError(
            f"{out}: is being written by another command; choose another --out"
        ) from error
    except BaseException as error:
        with suppress(OSError):  # a folder that was there before, or holds something by now
            for folder in missing:
                folder.rmdir()
        if isinstance(error, OSError):
            raise RunError(
                f"{out}: cannot be written: {error.strerror or error}; choose another --out"
            ) from error
        raise


def write_results(
    directory: Path,
    result: Result,
    identity: Mapping[str, str],
    config_json: bytes,
    write_input: Callable[[LogWriter], None] | None = None,
) -> None:
    """Write all of a run but its summary; deterministic but for the identity.

    `write_input` puts a recording in front of the results, where the log shall hold it too.
    """
    write_tum(directory / "trajectory.tum", result.trajectory)
    write_tum(directory / "keyframes.tum", result.keyframes)
    write_tum(directory / "odometry.tum", result.odometry)
    write_g2o(directory / "graph.g2o", result.keyframes.poses, result.edges, result.weights)
    write_times(directory / "graph.times.csv", result)
    write_nav2_map(directory, result.grid)
    write_map_png(directory / "map.png", result.grid, result.trajectory)
    never = math.inf  # a run that was cut off leaves nothing; bytes must not depend on the time
    with LogWriter(
        directory / "run.mcap", identity, sync_period_s=never, keep_partial=False
    ) as log:
        log.add_attachment("config.json", config_json, "application/json")
        if write_input is None:
            log.write(result.slam.extrinsics)
            for keyframe in result.slam.keyframes:  # enough to draw the map again
                log.write(keyframe.scan)
        else:
            write_input(log)
        _write_decisions(log, result)


def write_times(path: Path, result: Result) -> None:
    """The stamps that g2o has no place for: vertex, scan of the log, seconds."""
    rows = ["vertex,scan,stamp_s"]
    rows += [
        f"{k.index},{k.scan_index},{format_stamp(k.scan.stamp_ns)}" for k in result.slam.keyframes
    ]
    path.write_text("\n".join(rows) + "\n", encoding="ascii")


def _write_decisions(log: LogWriter, result: Result) -> None:
    records, closure_results = result.slam.records, result.slam.loops.closure_results
    for group in (
        result.truth, records.decisions, records.factors, closure_results, result.estimates,
        transforms(result), maps_along_the_way(result),
    ):  # fmt: skip
        for message in group:
            log.write(message)


def write_summary(directory: Path, summary: Mapping[str, Any]) -> None:
    """`summary.json`, the last file of a run."""
    text = json.dumps(summary, indent=2, allow_nan=False)
    (directory / "summary.json").write_text(text + "\n", encoding="utf-8")


def version() -> str:
    """Version of this software, as logs and summaries state it."""
    return library_name().rpartition("/")[2]
