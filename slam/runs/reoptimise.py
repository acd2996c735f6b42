"""`slam reoptimise`: the back end once more, over a finished run or a foreign g2o graph."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.batch_optimisation import FactorMaker
from slam.backend.edges import Edge, capped
from slam.backend.final_optimisation import FinalGraph, finalise
from slam.backend.g2o import read_g2o, write_g2o
from slam.backend.se2 import between, compose
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import FactorRecord, LaserExtrinsics, LaserScan, Message, TruePose
from slam.logs.trajectory import Trajectory, read_tum, write_tum
from slam.mapping.calibration import mount_in_force
from slam.mapping.config import SlamConfig
from slam.maps.map_picture import write_map_png
from slam.maps.nav2_map import write_nav2_map
from slam.maps.occupancy import build_map
from slam.runs.config_file import load_config
from slam.runs.errors import RunError
from slam.runs.run_directory import new_run, version, write_summary

COPIED = ("/tf", "/scan", "/truth", "/keyframe")  # what the new run takes over from the old


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A run as its directory holds it."""

    trajectory: Trajectory  # map_T_base at every scan
    odometry: Trajectory
    keyframes: Trajectory
    edges: list[Edge]
    records: list[FactorRecord]  # one for each edge
    messages: list[Message]  # sensor data and truth, as far as the run keeps them
    config_json: bytes


def reoptimise(
    source: Path, out: Path, config: Path | None, overrides: Sequence[str]
) -> dict[str, Any]:
    """Optimise a run or a g2o file again, and write what comes of it as a new run.

    The source is only read.  Of a run, all factors are judged anew, also loops that were
    removed before; its trajectory follows the keyframes.

    Raises:
        RunError: the source is no run, or the output cannot be written.
        GraphError: the graph is malformed or cannot be optimised.
        ConfigError: a setting is unknown or out of range.
    """
    settings = load_config(config, overrides)
    if source.is_dir():
        return _reoptimise_run(source, out, settings)
    return _reoptimise_g2o(source, out, settings)


def _reoptimise_g2o(source: Path, out: Path, settings: SlamConfig) -> dict[str, Any]:
    graph = read_g2o(source)
    # A foreign information matrix says all there is to say: nothing is added to it.
    config = settings.graph.model_copy(update={"match_sigma_trans": 0.0, "match_sigma_rot": 0.0})
    edges = [capped(edge) for edge in graph.edges]
    tamed = sum(a is not b for a, b in zip(edges, graph.edges, strict=True))
    maker = FactorMaker(config)
    final = finalise(graph.poses, edges, maker)
    final = replace(final, poses=_held(graph.poses, final.poses, graph.fixed or 0))
    with new_run(out) as partial:
        # A g2o file has no times: a second a vertex.  Ids may be too large to count seconds.
        stamps = np.arange(len(graph.ids)) * 1_000_000_000
        write_tum(partial / "keyframes.tum", Trajectory(stamps, final.poses))
        write_tum(partial / "trajectory.tum", Trajectory(stamps, final.poses))
        write_g2o(partial / "graph.g2o", final.poses, final.edges, final.informations)
        summary = _summary(source.name, final, settings)
        summary |= {"edges_tamed": tamed, "lines_skipped": graph.skipped}
        summary["lost"] = dict(graph.left_out)
        write_summary(partial, summary)
    return summary


def _held(
    before: NDArray[np.float64], after: NDArray[np.float64], fixed: int
) -> NDArray[np.float64]:
    """Return the poses, (n, 3), moved as one so that a vertex is where it was before."""
    if fixed == 0:  # the one that is held anyway
        return after
    return compose(before[fixed], between(after[fixed], after))


def _reoptimise_run(source: Path, out: Path, settings: SlamConfig) -> dict[str, Any]:
    run = read_stored(source)
    poses = run.keyframes.poses
    maker = FactorMaker(settings.graph)
    final = finalise(poses, run.edges, maker)
    rows = np.searchsorted(run.trajectory.stamps_ns, run.keyframes.stamps_ns)
    before = np.searchsorted(rows, np.arange(len(run.trajectory.stamps_ns)), side="right") - 1
    owner = np.maximum(before, 0)
    # Each scan keeps its place with respect to the keyframe before it.
    moved = compose(final.poses[owner], between(poses[owner], run.trajectory.poses))
    trajectory = Trajectory(run.trajectory.stamps_ns, moved)
    with new_run(out) as partial:
        write_tum(partial / "trajectory.tum", trajectory)
        write_tum(partial / "keyframes.tum", Trajectory(run.keyframes.stamps_ns, final.poses))
        write_tum(partial / "odometry.tum", run.odometry)
        write_g2o(partial / "graph.g2o", final.poses, final.edges, final.informations)
        _write_map(partial, run, trajectory, settings)
        _write_log(partial / "run.mcap", run, final, source.name, settings)
        write_summary(partial, _summary(source.name, final, settings))
    return _summary(source.name, final, settings)


def read_stored(directory: Path) -> StoredRun:
    """Read what a RUN directory holds of its graph.

    Raises:
        RunError: parts are missing.
        LogError: `run.mcap` cannot be read.
    """
    log_path = directory / "run.mcap"
    if not log_path.is_file() or not (directory / "trajectory.tum").is_file():
        raise RunError(f"{directory}: is no finished run: run.mcap or trajectory.tum is missing")
    records: list[FactorRecord] = []
    kept: list[Message] = []
    config_json = b"{}"
    with open_log(log_path) as log:
        for message in log.messages(("/factor", *COPIED)):
            (records if isinstance(message, FactorRecord) else kept).append(message)  # type: ignore[arg-type]
        for attachment in log.attachments():
            if attachment.name == "config.json":
                config_json = attachment.data
    records = [r for r in records if r.kind != "prior" and (r.used or r.kind == "loop")]
    return StoredRun(
        read_tum(directory / "trajectory.tum"),
        read_tum(directory / "odometry.tum"),
        read_tum(directory / "keyframes.tum"),
        [_edge(record) for record in records],
        records,
        kept,
        config_json,
    )


def _edge(record: FactorRecord) -> Edge:
    covariance = np.array(record.covariance).reshape(3, 3)
    information = np.linalg.inv(covariance)
    return Edge(
        record.kind,  # type: ignore[arg-type]  # priors were left out
        record.i,
        record.j,
        Pose2(record.x, record.y, record.theta),
        0.5 * (information + information.T),
    )


def _write_map(
    directory: Path, run: StoredRun, trajectory: Trajectory, settings: SlamConfig
) -> None:
    """Draw the map anew from the scans that the run keeps; without any, there is none."""
    scans = [m for m in run.messages if isinstance(m, LaserScan)]
    settings_then = json.loads(run.config_json)
    all_extrinsics = [
        mount_in_force(m, settings_then) for m in run.messages if isinstance(m, LaserExtrinsics)
    ]
    rows: NDArray[np.int64] = np.searchsorted(
        trajectory.stamps_ns, [scan.stamp_ns for scan in scans]
    )
    if not scans or rows.max() >= len(trajectory.stamps_ns):
        return
    extrinsics = (
        np.array([all_extrinsics[-1].x, all_extrinsics[-1].y, all_extrinsics[-1].theta])
        if all_extrinsics
        else np.zeros(3)
    )
    grid = build_map(scans, compose(trajectory.poses[rows], extrinsics), settings.map)
    write_nav2_map(directory, grid)
    write_map_png(directory / "map.png", grid, trajectory)


def _write_log(
    path: Path, run: StoredRun, final: FinalGraph, source: str, settings: SlamConfig
) -> None:
    identity = {
        "source": source, "version": version(), "config_sha256": settings.sha256(),
        "reoptimised": "true",
    }  # fmt: skip
    with LogWriter(path, identity, keep_partial=False) as log:
        log.add_attachment(
            "config.json", settings.model_dump_json(indent=2).encode(), "application/json"
        )
        for message in run.messages:
            if isinstance(message, (LaserScan, LaserExtrinsics, TruePose)):
                log.write(message)
        for k, record in enumerate(run.records):
            note = final.removed.get(k, record.note)
            log.write(replace(record, used=k not in final.removed, note=note))


def _summary(source: str, final: FinalGraph, settings: SlamConfig) -> dict[str, Any]:
    rejected = len(final.removed)
    return {
        "log": source,
        "keyframes": len(final.poses),
        "edges": len(final.edges) + rejected,
        "loops": {
            "candidates": final.loops, "accepted": final.loops - rejected, "rejected": rejected,
        },
        "error_before": final.error_before,
        "error_after": final.error_after,
        "version": version(),
        "config_sha256": settings.sha256(),
    }  # fmt: skip
