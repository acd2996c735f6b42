"""Drives of the interval benchmark: what is compared, and one drive under each setting.

Loops stay open: what is compared is the chain of keyframes.  Matcher and back end are the same
for all; a drive is simulated once and given to every setting.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.drive import EPOCH_NS, simulate
from slam.drivers.simulators.worlds import scenario
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.scan import PreparedScan, prepare
from slam.logs.messages import LaserScan, SensorMessage, TruePose
from slam.logs.trajectory import Trajectory

from slam.evaluation.metrics import Association, absolute_errors, align
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe
from slam.mapping.keyframe_selection import KeyframeSelector
from slam.mapping.scan_localiser import ScanLocaliser
from slam.mapping.scan_priors import predict_poses
from slam.mapping.slam import Slam

WORLDS = ("testbed", "plain-corridor", "office", "clutter", "mixed")
LONGEST_M = 30.0  # a drive ends here, so that no world outweighs the others in time
WARM_UP_NS = 8_000_000_000  # of a drive
LOCALISED = 5  # every so manieth scan is localised and judged

CONSTANT_M = (0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.1, 1.5, 2.0)
GATES = ((0.5, 0.5), (1.0, 0.5))  # m, rad
OVERLAPS = (0.7, 0.9)


@dataclass(frozen=True, slots=True)
class Setting:
    """One way to choose keyframes."""

    method: str
    label: str
    keyframes: KeyframeConfig
    misled: bool = False  # predicts with the normals of other beams


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a setting made of one drive."""

    matches: int
    keyframes: int
    ate_m: float  # of every LOCALISED-th scan
    keyframe_ate_m: float
    cpu_ms: float  # of front and back end, up to the last keyframe


def settings() -> list[Setting]:
    """All that is compared; the turn limit is the shipped one but for the gates."""
    shipped = KeyframeConfig()
    found = [
        Setting("constant", f"{m:g} m", _with(shipped, method="constant", interval=m))
        for m in CONSTANT_M
    ]
    found += [
        Setting(
            "gate", f"{m:g} m, {turn:g} rad",
            _with(shipped, method="constant", interval=m, max_turn=turn),
        )
        for m, turn in GATES
    ]  # fmt: skip
    found += [
        Setting("overlap", f"{share:g}", _with(shipped, method="overlap", least_overlap=share))
        for share in OVERLAPS
    ]
    predicting = _with(shipped, method="information")
    found.append(Setting("sdp-pe", "shipped", _with(shipped, method="sdp-pe")))
    found.append(Setting("information", "shipped", predicting))
    found.append(Setting("information-permuted", "shipped", predicting, misled=True))
    return found


def _with(config: KeyframeConfig, **changes: object) -> KeyframeConfig:
    return KeyframeConfig.model_validate({**config.model_dump(), **changes})


class _MisledSelector(KeyframeSelector):
    """Predicts with each beam's line given to another beam: the counter-test of `information`."""

    def _view(self, keyframe: Keyframe) -> PreparedScan:
        return permuted(keyframe.prepared, np.random.default_rng(keyframe.index + 1))


class _Misled(Slam):
    """A run whose keyframes are chosen by the misled selector."""

    def __init__(self, config: SlamConfig) -> None:
        super().__init__(config)
        self._selector = _MisledSelector(config)


def permuted(scan: PreparedScan, rng: np.random.Generator) -> PreparedScan:
    """The scan with its normals shuffled among the beams that have one."""
    lined = np.flatnonzero(np.any(scan.lines[:, :2] != 0.0, axis=1))
    lines = scan.lines.copy()
    lines[lined] = scan.lines[rng.permutation(lined)]
    lines.setflags(write=False)
    return scan._replace(lines=lines)


def messages_of(world: str, seed: int) -> list[SensorMessage]:
    """The first LONGEST_M metres of a drive."""
    kept: list[SensorMessage] = []
    last: TruePose | None = None
    travelled = 0.0
    for message in simulate(scenario(world, seed), seed=seed):
        if isinstance(message, TruePose):
            if last is not None:
                travelled += math.hypot(message.x - last.x, message.y - last.y)
            if travelled > LONGEST_M:
                break
            last = message
        kept.append(message)
    return kept


def warm_up() -> None:
    """Run a short drive under every setting, so that no drive that is timed compiles kernels."""
    begun = [m for m in messages_of("testbed", 0) if m.stamp_ns < EPOCH_NS + WARM_UP_NS]
    for setting in settings():
        outcome_of(begun, setting)


def outcomes_of(world: str, seed: int, compared: Sequence[Setting]) -> list[Outcome]:
    """One drive under every setting."""
    messages = messages_of(world, seed)
    return [outcome_of(messages, setting) for setting in compared]


def outcome_of(messages: Sequence[SensorMessage], setting: Setting) -> Outcome:
    """One drive under one setting."""
    shipped = SlamConfig()
    loops = shipped.loops.model_copy(update={"enabled": False})
    config = shipped.model_copy(update={"loops": loops, "keyframes": setting.keyframes})
    slam = (_Misled if setting.misled else Slam)(config)
    felt = [message for message in messages if not isinstance(message, TruePose)]
    begin = time.process_time()
    for message in felt:
        slam.step(message)
    slam.finish_input()
    cpu_ms = 1e3 * (time.process_time() - begin)
    assert slam.graph is not None
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in messages if isinstance(m, TruePose)}
    rows, found = trajectory_of(slam, messages, LOCALISED)
    stamps = slam.scans.stamps_ns
    keyframes = np.array([k.scan_index for k in slam.keyframes])
    return Outcome(
        slam.matches, len(slam.keyframes),
        ate(stamps[rows], found, truth),
        ate(stamps[keyframes], slam.graph.poses.copy(), truth),
        cpu_ms,
    )  # fmt: skip


def trajectory_of(
    slam: Slam, messages: Sequence[SensorMessage], every: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Rows (n,) of every `every`-th scan, and their poses (n, 3) localised among the keyframes."""
    assert slam.graph is not None
    scans = {m.stamp_ns: m for m in messages if isinstance(m, LaserScan)}
    keyframes = np.array([k.scan_index for k in slam.keyframes])
    poses, stamps = slam.graph.poses.copy(), slam.scans.stamps_ns
    rows = np.arange(0, len(slam.scans), every)
    expected = predict_poses(slam.scans.odom_poses, keyframes, poses, ())
    localiser = ScanLocaliser(slam.keyframes, poses, slam.config.localise, slam.config.matcher)
    found = np.empty((len(rows), 3))
    for k, row in enumerate(rows.tolist()):
        scan = prepare(scans[int(stamps[row])], slam.extrinsics, slam.config.scan)
        pose = localiser.locate(
            scan, Pose2(*expected.poses[row]), reach_m=float(expected.reach_m[row])
        )
        found[k] = pose.x(), pose.y(), pose.theta()
    return rows, found


def ate(
    stamps_ns: NDArray[np.int64],
    poses: NDArray[np.float64],
    truth: Mapping[int, tuple[float, float, float]],
) -> float:
    """Root mean square of the position errors after alignment, m."""
    true = np.array([truth[stamp] for stamp in stamps_ns.tolist()])
    pairs = Association(Trajectory(stamps_ns, poses), Trajectory(stamps_ns, true))
    errors = absolute_errors(pairs, align(poses, true)).trans_m
    return float(np.sqrt(np.mean(errors**2)))
