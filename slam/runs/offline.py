"""A whole run from a source of messages: track, optimise, localise every scan, draw the map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.batch import OUTLIER
from slam.backend.edges import Edge
from slam.backend.se2 import compose
from slam.frontend.deskew import deskew
from slam.frontend.scan import PreparedScan, prepare
from slam.logs.messages import (
    LaserScan,
    Message,
    OccupancyMap,
    PoseEstimate,
    TruePose,
    WheelOdometry,
)
from slam.logs.trajectory import Trajectory
from slam.mapping.config import SlamConfig
from slam.mapping.message_checks import validate_message
from slam.mapping.relocalise import PriorMap
from slam.mapping.scan_localiser import ScanLocaliser, refine_edges
from slam.mapping.scan_priors import PredictedPoses, predict_poses
from slam.mapping.slam import BACKWARDS, Slam
from slam.mapping.stage_timer import NullTimer
from slam.maps.occupancy import build_map
from slam.runs.errors import SlamError
from slam.runs.process_pool import with_outcomes

Source = Callable[[], Iterable[Message]]
Progress = Callable[[str, float], None]  # stage, messages or scans done
READMITTED = "accepted: refused along the way, but the whole graph agrees"


@dataclass(frozen=True, eq=False)
class Result:
    """All that a finished run knows; poses are map_T_base."""

    slam: Slam
    trajectory: Trajectory  # at every scan
    odometry: Trajectory  # odom_T_base at every scan
    keyframes: Trajectory
    estimates: list[PoseEstimate]  # at every scan, with covariance
    edges: list[Edge]  # of the final graph
    weights: list[NDArray[np.float64]]  # their (3, 3) informations as optimised
    grid: OccupancyMap
    truth: list[TruePose]
    lost: Counter[str]
    matches: int  # of keyframes and, at the end, of single scans


def run_offline(
    source: Source,
    config: SlamConfig,
    watch: NullTimer | None = None,
    progress: Progress | None = None,
    step: Callable[[Slam, Message], None] = Slam.step,
    prior_map: PriorMap | None = None,
    processes: int = 1,
) -> Result:
    """Run SLAM over a source of messages, which is read twice.

    Args:
        source: gives the messages from the start, each time it is called.
        config: of the whole run.
        watch: measures where the time goes.
        progress: told the stage and the number of messages or scans done.
        step: how a message is handed to the pipeline; replaced to time it.
        prior_map: a run to go on with; its map becomes part of this one.
        processes: to place the scans with; more than one only in a process without other threads.

    Raises:
        SlamError: the log holds no usable scan, or no odometry, or its place in the past is not
            found.
    """
    watch, tell = watch or NullTimer(), progress or (lambda stage, done: None)
    slam = Slam(config, watch)
    if prior_map is not None:
        slam.resume(prior_map)
    truth = _track(slam, _timed(source(), watch), tell, step)
    if prior_map is None:
        return finish(slam, source, truth, watch, tell, processes)
    if (
        slam.not_relocalised
        and len(slam.scans) == len(prior_map.keyframes)
        and slam.lost[BACKWARDS]
    ):
        raise SlamError("the log is older than the run to go on with: name one recorded after it")
    if slam.not_relocalised:
        raise SlamError(
            "the robot was not found in the map to go on with, or it looks alike elsewhere: "
            "say where it starts, --start end or --start x,y,theta" + _left_out(slam)
        )
    before = [k.scan for k in prior_map.keyframes]
    truth = [*prior_map.truth, *truth]
    return finish(slam, lambda: chain(before, source()), truth, watch, tell, processes)


def _track(
    slam: Slam, messages: Iterable[Message], tell: Progress, step: Callable[[Slam, Message], None]
) -> list[TruePose]:
    """Hand all messages to the pipeline; returns the true poses among them."""
    truth: list[TruePose] = []
    count, has_odometry = 0, False
    for count, message in enumerate(messages, start=1):
        if not feed(slam, message, step):
            continue
        has_odometry = has_odometry or isinstance(message, WheelOdometry)
        if isinstance(message, TruePose):
            truth.append(message)
        tell("tracking", count)
    slam.finish_input()
    if len(slam.scans) and not has_odometry:
        raise SlamError(
            f"no usable odometry among {count} messages: record the robot's wheels (/odom) too"
        )
    return truth


def feed(slam: Slam, message: Message, step: Callable[[Slam, Message], None] = Slam.step) -> bool:
    """Hand one message to the pipeline, live and in replay alike; False if it is of no use."""
    if cause := validate_message(message):
        slam.lost[cause] += 1
        return False
    step(slam, message)
    return True


def finish(
    slam: Slam, source: Source, truth: list[TruePose], watch: NullTimer, tell: Progress,
    processes: int = 1,
) -> Result:  # fmt: skip
    """Optimise a graph whose input has ended, and make all results from it.

    More than one of the `processes` is only for a process without other threads.
    """
    if slam.graph is None:
        seen = len(slam.scans)
        raise SlamError(
            f"no usable scan among {seen}: the log must hold scans with at least "
            f"{slam.config.matcher.min_pairs} returns each" + _left_out(slam)
        )
    config, graph = slam.config, slam.graph
    with watch("optimising"):
        settle(slam)
        for _ in range(config.localise.refine_passes):
            graph.add_edges_batch(
                refine_edges(slam.keyframes, graph, config.localise, config.matcher)
            )
            graph.optimise()
        marginals = graph.marginals()
    poses = graph.poses.copy()
    stamps = slam.scans.stamps_ns
    odometry = slam.scans.odom_poses
    keyframe_scans = np.array([k.scan_index for k in slam.keyframes])
    place_scans, places, owners = slam.places(poses)
    predicted = predict_poses(odometry, place_scans, places, slam.odometry_faulty)
    found, matches = predicted.poses, 0
    if config.localise.every_scan:
        with watch("localising"):
            found, matches = _localise(slam, source, poses, predicted, watch, tell, processes)
    with watch("map"):
        extrinsics = np.array([slam.extrinsics.x, slam.extrinsics.y, slam.extrinsics.theta])
        scans = [k.scan for k in slam.keyframes]
        grid = build_map(scans, compose(found[keyframe_scans], extrinsics), config.map)
    return Result(
        slam,
        Trajectory(stamps, found),
        Trajectory(stamps, odometry),
        Trajectory(stamps[keyframe_scans], poses),
        _estimates(slam, stamps, found, marginals[owners[predicted.before]]),
        graph.edges,
        [graph.weight(edge) for edge in graph.edges],
        grid,
        truth,
        slam.lost,
        slam.matches + matches,
    )


def _left_out(slam: Slam) -> str:
    return "".join(f"; left out: {n} {cause}" for cause, n in sorted(slam.lost.items()))


def settle(slam: Slam) -> None:
    """Batch optimisation, in which the whole graph judges every closure anew, on record.

    What it speaks against is withdrawn.  What was refused along the way, when an earlier closure
    or a match that slid may have bent the graph, is admitted if the rest agrees after all.
    """
    graph = slam.graph
    assert graph is not None
    rejected = slam.loops.rejected
    graph.add_edges_batch([candidate.edge for candidate in rejected])
    graph.optimise()
    weights = {id(graph.edges[k]): weight for k, weight in graph.loop_weights.items()}
    judged: dict[tuple[int, int], tuple[bool, str]] = {}
    for candidate in rejected:
        edge, used = candidate.edge, weights[id(candidate.edge)] >= OUTLIER
        note = READMITTED if used else f"chi-square {candidate.chi_square:.1f} against the graph"
        slam.records.add_edge(candidate.stamp_ns, edge, used, note)
        judged[edge.i, edge.j] = used, note
    for edge in [e for e in graph.edges if weights.get(id(e), 1.0) < OUTLIER]:
        chi_square = edge.chi_square(graph.poses)
        note = f"withdrawn: chi-square {chi_square:.0f} against the whole graph"
        judged.setdefault((edge.i, edge.j), (False, note))
        graph.drop(edge)
    slam.records.factors = [
        replace(f, used=judged[f.i, f.j][0], note=judged[f.i, f.j][1])
        if f.kind == "loop" and (f.i, f.j) in judged else f
        for f in slam.records.factors
    ]  # fmt: skip
    slam.loops.closure_results = [
        replace(v, accepted=judged[v.i, v.j][0], reason=judged[v.i, v.j][1])
        if (v.i, v.j) in judged else v
        for v in slam.loops.closure_results
    ]  # fmt: skip


def _timed(messages: Iterable[Message], watch: NullTimer) -> Iterable[Message]:
    """The messages, with the time to get them booked as reading."""
    iterator = iter(messages)
    while True:
        with watch("reading"):
            message = next(iterator, None)
        if message is None:
            return
        yield message


def _localise(
    slam: Slam, source: Source, poses: NDArray[np.float64], predicted: PredictedPoses,
    watch: NullTimer, tell: Progress, processes: int,
) -> tuple[NDArray[np.float64], int]:  # fmt: skip
    """Poses of all scans by matching each among the keyframes, (n, 3), and the matches made."""
    localiser = ScanLocaliser(slam.keyframes, poses, slam.config.localise, slam.config.matcher)
    found = predicted.poses.copy()

    def prepared() -> Iterator[tuple[PreparedScan, Pose2]]:
        for row, scan in enumerate(_scans_again(slam, _timed(source(), watch))):
            yield prepare(scan, slam.extrinsics, slam.config.scan), Pose2(*predicted.poses[row])

    matched = with_outcomes(prepared(), lambda seen: localiser.match_from(*seen), processes)
    for row, ((scan, guess), first) in enumerate(matched):
        odometry_faulty, reach_m = (
            bool(predicted.odometry_faulty[row]),
            float(predicted.reach_m[row]),
        )
        pose = localiser.locate(scan, guess, odometry_faulty, first, reach_m)
        found[row] = pose.x(), pose.y(), pose.theta()
        tell("localising", row + 1)
    return found, localiser.matches


def _scans_again(slam: Slam, messages: Iterable[Message]) -> Iterator[LaserScan]:
    """Yield the scans that the pipeline has used, as it has used them."""
    stamps, row = slam.scans.stamps_ns, 0
    for message in messages:
        if row == len(stamps):
            return
        if not isinstance(message, LaserScan) or validate_message(message):
            continue
        if message.stamp_ns != stamps[row]:
            continue
        sweep = slam.scans.sweep(row)
        yield message if sweep is None else deskew(message, slam.extrinsics, sweep)
        row += 1


def _estimates(
    slam: Slam, stamps: NDArray[np.int64], poses: NDArray[np.float64],
    covariances: NDArray[np.float64],
) -> list[PoseEstimate]:  # fmt: skip
    """Every scan's pose; its uncertainty is that of the keyframe before, plus a match's floor."""
    lost = {estimate.stamp_ns for estimate in slam.records.estimates if estimate.lost}
    floor = np.diag([slam.config.graph.match_sigma_trans] * 2 + [slam.config.graph.match_sigma_rot])
    flat = (covariances + floor**2).reshape(len(stamps), 9)
    return [
        PoseEstimate(
            int(t), float(p[0]), float(p[1]), float(p[2]), tuple(c.tolist()), int(t) in lost
        )
        for t, p, c in zip(stamps, poses, flat, strict=True)
    ]
