"""A whole run from a source of messages: track, optimise, localise every scan, draw the map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

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
)
from slam.logs.trajectory import Trajectory
from slam.mapping.config import SlamConfig
from slam.mapping.message_checks import validate_message
from slam.mapping.relocalise import PriorMap
from slam.mapping.scan_localiser import Matched, ScanLocaliser
from slam.mapping.slam import BACKWARDS, FinalMap, Slam
from slam.mapping.stage_timer import NullTimer
from slam.maps.occupancy import build_map
from slam.runs.errors import SlamError
from slam.runs.thread_pool import with_outcomes

Source = Callable[[], Iterable[Message]]
Progress = Callable[[str, float], None]  # stage, messages or scans done
BATCH = 50  # scans that are placed at once: some 10 ms of work, and a part of `progress.EVERY`


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
    timer: NullTimer | None = None,
    progress: Progress | None = None,
    step: Callable[[Slam, Message], None] = Slam.step,
    prior_map: PriorMap | None = None,
    threads: int = 1,
) -> Result:
    """Run SLAM over a source of messages, which is read twice.

    Args:
        source: gives the messages from the start, each time it is called.
        config: of the whole run.
        timer: measures where the time goes.
        progress: called with the stage and the number of messages or scans done.
        step: how a message is handed to the pipeline; replaced to time it.
        prior_map: a map to continue, which becomes part of this one.
        threads: to place the scans with.

    Raises:
        SlamError: the log holds no usable scan, or no odometry, or its place in the prior map is
            not found.
    """
    timer, on_progress = timer or NullTimer(), progress or (lambda stage, done: None)
    slam = Slam(config, timer)
    if prior_map is not None:
        slam.resume(prior_map)
    truth = _track(slam, _timed(source(), timer), on_progress, step)
    if prior_map is None:
        return finish(slam, source, truth, timer, on_progress, threads)
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
    return finish(slam, lambda: chain(before, source()), truth, timer, on_progress, threads)


def _track(
    slam: Slam,
    messages: Iterable[Message],
    on_progress: Progress,
    step: Callable[[Slam, Message], None],
) -> list[TruePose]:
    """Hand all messages to the pipeline; returns the true poses among them."""
    truth: list[TruePose] = []
    for count, message in enumerate(messages, start=1):
        if not feed(slam, message, step):
            continue
        if isinstance(message, TruePose):
            truth.append(message)
        on_progress("tracking", count)
    slam.finish_input()
    return truth


def feed(slam: Slam, message: Message, step: Callable[[Slam, Message], None] = Slam.step) -> bool:
    """Hand one message to the pipeline, live and in replay alike; False if it is of no use."""
    if cause := validate_message(message):
        slam.lost[cause] += 1
        return False
    step(slam, message)
    return True


def finish(
    slam: Slam, source: Source, truth: Sequence[TruePose] = (), timer: NullTimer | None = None,
    progress: Progress | None = None, threads: int = 1,
) -> Result:  # fmt: skip
    """Optimise a graph whose input has ended, and make all results from it.

    Scans are placed with so many `threads`; the result does not depend on them.

    Raises:
        SlamError: there was no usable scan.
    """
    timer, on_progress = timer or NullTimer(), progress or (lambda stage, done: None)
    if slam.graph is None:
        seen = len(slam.scans)
        raise SlamError(
            f"no usable scan among {seen}: the log must hold scans with at least "
            f"{slam.config.matcher.min_pairs} returns each" + _left_out(slam)
        )
    config = slam.config
    with timer("optimising"):
        final = slam.finalise()
    stamps, found, matches = slam.scans.stamps_ns, final.scans.poses, 0
    if config.localise.every_scan:
        with timer("localising"):
            found, matches = _localise(slam, source, final, timer, on_progress, threads)
    keyframe_scans = np.array([k.scan_index for k in slam.keyframes])
    with timer("map"):
        base_T_laser = np.array([slam.extrinsics.x, slam.extrinsics.y, slam.extrinsics.theta])
        scans = [k.scan for k in slam.keyframes]
        grid = build_map(scans, compose(found[keyframe_scans], base_T_laser), config.map)
    return Result(
        slam,
        Trajectory(stamps, found),
        Trajectory(stamps, slam.scans.odom_poses),
        Trajectory(stamps[keyframe_scans], final.poses),
        _estimates(slam, stamps, found, final.covariances),
        final.edges,
        final.informations,
        grid,
        list(truth),
        slam.lost,
        slam.matches + matches,
    )


def _left_out(slam: Slam) -> str:
    return "".join(f"; left out: {n} {cause}" for cause, n in sorted(slam.lost.items()))


def _timed(messages: Iterable[Message], timer: NullTimer) -> Iterable[Message]:
    """The messages, with the time to get them booked as reading."""
    iterator = iter(messages)
    while True:
        with timer("reading"):
            message = next(iterator, None)
        if message is None:
            return
        yield message


def _localise(
    slam: Slam, source: Source, final: FinalMap, timer: NullTimer, on_progress: Progress,
    threads: int,
) -> tuple[NDArray[np.float64], int]:  # fmt: skip
    """Poses of all scans by matching each among the keyframes, (n, 3), and the matches made."""
    config, predicted = slam.config, final.scans
    localiser = ScanLocaliser(slam.keyframes, final.poses, config.localise, config.matcher)
    found = predicted.poses.copy()

    def batches() -> Iterator[tuple[list[PreparedScan], NDArray[np.float64]]]:
        scans = _scans_again(slam, _timed(source(), timer))
        row = 0
        while batch := [prepare(s, slam.extrinsics, config.scan) for s in islice(scans, BATCH)]:
            yield batch, predicted.poses[row : row + len(batch)]
            row += len(batch)

    def match(batch: tuple[list[PreparedScan], NDArray[np.float64]]) -> list[Matched]:
        return localiser.match_batch(*batch)

    row = 0
    for (scans, guesses), matched in with_outcomes(batches(), match, threads):
        for scan, guess, first in zip(scans, guesses, matched, strict=True):
            faulty, reach_m = bool(predicted.odometry_faulty[row]), float(predicted.reach_m[row])
            pose = localiser.locate(scan, Pose2(*guess), faulty, first, reach_m)
            found[row] = pose.x(), pose.y(), pose.theta()
            row += 1
        on_progress("localising", row)
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
        scan = slam.nothing_code.without_code(message)
        yield scan if sweep is None else deskew(scan, slam.extrinsics, sweep, slam.sweeps.order)
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
