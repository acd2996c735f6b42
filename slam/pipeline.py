"""The pipeline: one step function for the robot and for the replay.

No file, device, clock, thread or print in here: equal messages give equal graphs, bit for bit.
"""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from gtsam import Pose2

from backend.pose_graph import Edge, PoseGraph
from frontend.keyframes import Interval, interval_after, reason_to_keep
from frontend.matching import Prior, Reference
from frontend.scan import PreparedScan, prepare
from logs.messages import (
    FactorRecord,
    KeyframeDecision,
    LaserMount,
    LaserScan,
    Message,
    PoseEstimate,
    WheelOdometry,
)
from slam.config import SlamConfig
from slam.keyframe import Keyframe
from slam.loops import LoopCloser
from slam.odometry import OdometryBuffer
from slam.tracking import Tracked, track

STAMP_JITTER_S = 0.15  # between neighbouring scans; intel's stamps come in bursts
MAX_WAIT_NS = 1_000_000_000  # a scan waits this long (in message time) for odometry after it


class Slam:
    """Messages in, a pose graph out."""

    def __init__(self, config: SlamConfig) -> None:
        self.config = config
        self.keyframes: list[Keyframe] = []
        self.scan_stamps_ns: list[int] = []
        self.odom_poses: list[tuple[float, float, float]] = []  # odom_T_base of each scan
        self.scan_keyframes: list[int] = []  # the keyframe before each scan
        self.decisions: list[KeyframeDecision] = []
        self.factors: list[FactorRecord] = []
        self.estimates: list[PoseEstimate] = []
        self.lost: Counter[str] = Counter()
        self.matches = 0
        self.mount = LaserMount(0, 0.0, 0.0, 0.0)
        self.graph: PoseGraph | None = None
        self.loops = LoopCloser(config.loops, config.matcher)
        self._odometry = OdometryBuffer()
        self._pending: deque[LaserScan] = deque()
        self._interval = Interval(0.0, None)
        self._path_m = 0.0  # by odometry, since the last keyframe
        self._path_rad = 0.0
        self._peak_speed = 0.0  # m/s and rad/s, the fastest single step since the last keyframe
        self._peak_rate = 0.0
        self._last_step: tuple[Pose2, float] | None = None  # the last keyframe's motion, seconds

    def step(self, message: Message) -> None:
        """Take in one message, in the order of the log."""
        if isinstance(message, LaserScan):
            self._pending.append(message)
        elif isinstance(message, WheelOdometry):
            if not self._odometry.add(message):
                self.lost["odometry with a stamp that runs backwards"] += 1
        elif isinstance(message, LaserMount):
            self.mount = message
        else:
            return
        self._drain(wait=True)

    def finish_input(self) -> None:
        """No more messages will come: use what still waits."""
        self._drain(wait=False)
        self.loops.finish()

    def _drain(self, wait: bool) -> None:
        while self._pending:
            scan = self._pending[0]
            if wait and (not self._odometry or self._odometry.last_ns < scan.stamp_ns):
                if self._pending[-1].stamp_ns - scan.stamp_ns < MAX_WAIT_NS:
                    return
                self.lost["scan without odometry in time"] += 1
            self._pending.popleft()
            odom_T_base = self._odometry.at(scan.stamp_ns) if self._odometry else Pose2()
            self._take(scan, odom_T_base)

    def _take(self, scan: LaserScan, odom_T_base: Pose2) -> None:
        """Use one scan whose odometry is known."""
        if self.scan_stamps_ns and scan.stamp_ns <= self.scan_stamps_ns[-1]:
            self.lost["scan with a stamp that runs backwards"] += 1
            return
        if not np.isfinite(scan.ranges).any():
            self.lost["scan without any return"] += 1
        self._measure_path(scan, odom_T_base)
        self.scan_stamps_ns.append(scan.stamp_ns)
        self.odom_poses.append((odom_T_base.x(), odom_T_base.y(), odom_T_base.theta()))
        self._consider(scan, odom_T_base)
        self.scan_keyframes.append(len(self.keyframes) - 1)

    def _measure_path(self, scan: LaserScan, odom_T_base: Pose2) -> None:
        if not self.odom_poses:
            return
        step = Pose2(*self.odom_poses[-1]).between(odom_T_base)
        seconds = max((scan.stamp_ns - self.scan_stamps_ns[-1]) * 1e-9, 1e-3)
        length, turn = float(np.hypot(step.x(), step.y())), abs(step.theta())
        self._path_m += length
        self._path_rad += turn
        # Stamps jitter by more than the time between them in some logs.
        seconds += STAMP_JITTER_S
        self._peak_speed = max(self._peak_speed, length / seconds)
        self._peak_rate = max(self._peak_rate, turn / seconds)

    def _consider(self, scan: LaserScan, odom_T_base: Pose2) -> None:
        if not self.keyframes:
            prepared = prepare(scan, self.mount, self.config.scan)
            if prepared.valid < self.config.matcher.min_pairs:
                return
            self._begin(scan, prepared, odom_T_base)
            return
        last = self.keyframes[-1]
        moved = last.odom_T_base.between(odom_T_base)
        seconds = (scan.stamp_ns - last.scan.stamp_ns) * 1e-9
        scans = len(self.scan_stamps_ns) - 1 - last.scan_index
        reason = reason_to_keep(moved, scans, seconds, self._interval, self.config.keyframes)
        if not reason:
            return
        prepared = prepare(scan, self.mount, self.config.scan)
        if prepared.valid < self.config.matcher.min_pairs:
            self.lost["keyframe postponed: scan too empty"] += 1
            return
        self._extend(scan, prepared, odom_T_base, moved, seconds, reason)

    def _begin(self, scan: LaserScan, prepared: PreparedScan, odom_T_base: Pose2) -> None:
        self.graph = PoseGraph(Pose2(), self.config.graph)
        self._record_decision(scan, "first", Pose2(), None)
        self._keep(scan, prepared, odom_T_base, 0.0)

    def _extend(
        self, scan: LaserScan, prepared: PreparedScan, odom_T_base: Pose2, moved: Pose2,
        seconds: float, reason: str,
    ) -> None:  # fmt: skip
        assert self.graph is not None
        tracked = self._track(prepared, moved, seconds)
        self.matches += 1
        last = self.keyframes[-1]
        new = len(self.keyframes)
        step = tracked.result.target_T_source if tracked.match_trusted else moved
        edges = self._edges(scan, tracked, moved, new)
        self.graph.add_keyframe(self.graph.pose(last.index) * step, edges)
        self._record_decision(scan, reason, moved, tracked)
        self._last_step = (step, seconds)
        self._keep(scan, prepared, odom_T_base, float(np.hypot(step.x(), step.y())))
        closures = self.loops.close(self.keyframes, self.graph)
        if closures:
            self.graph.add_edges(closures)
            self.loops.moved()
            for edge in closures:
                self._record_edge(scan.stamp_ns, edge, True, "")
        self._record_estimate(scan.stamp_ns, tracked.lost)

    def _track(self, prepared: PreparedScan, moved: Pose2, seconds: float) -> Tracked:
        assert self.graph is not None
        last = self.keyframes[-1]
        base = self.graph.pose(last.index)
        references = [
            Reference(base.between(self.graph.pose(k.index)), k.prepared)
            for k in self.keyframes[-self.config.tracking.references :]
        ]
        covariance = self.config.odometry.covariance(self._path_m, self._path_rad)
        limits = self.config.odometry
        plausible = self._peak_speed <= limits.max_speed and self._peak_rate <= limits.max_turn_rate
        return track(
            references, prepared, Prior(moved, covariance), self._alternatives(moved, seconds),
            plausible, self.config.tracking, self.config.matcher,
        )  # fmt: skip

    def _alternatives(self, moved: Pose2, seconds: float) -> list[tuple[str, Pose2]]:
        """Where else to start a match when odometry looks wrong."""
        starts = [
            ("zero motion", Pose2()),
            ("mirrored translation", Pose2(-moved.x(), -moved.y(), moved.theta())),
            ("turn only", Pose2(0.0, 0.0, moved.theta())),
            ("translation only", Pose2(moved.x(), moved.y(), 0.0)),
        ]
        if self._last_step is not None:
            step, duration = self._last_step
            share = min(seconds / max(duration, 1e-3), 3.0)
            starts.append(("previous velocity", Pose2.Expmap(share * Pose2.Logmap(step))))
        return starts

    def _edges(self, scan: LaserScan, tracked: Tracked, moved: Pose2, new: int) -> list[Edge]:
        """Odometry and match factors of a keyframe; what is refused is recorded, not added."""
        covariance = self.config.odometry.covariance(self._path_m, self._path_rad)
        note = tracked.note
        if tracked.lost:  # widened: say that little is known
            covariance = covariance * self.config.lost_inflation**2
            note = f"lost: {tracked.note}"
        odometry = Edge("odometry", new - 1, new, moved, np.linalg.inv(covariance))
        result = tracked.result
        matched = Edge("icp", new - 1, new, result.target_T_source, result.information)
        edges = []
        for edge, used in (
            (odometry, tracked.odometry_trusted or tracked.lost),
            (matched, tracked.match_trusted),
        ):
            if used:
                edges.append(edge)
            self._record_edge(scan.stamp_ns, edge, used, note if not used or tracked.lost else "")
        return edges

    def _keep(
        self, scan: LaserScan, prepared: PreparedScan, odom_T_base: Pose2, step_m: float
    ) -> None:
        travelled = step_m + (self.keyframes[-1].travelled_m if self.keyframes else 0.0)
        index = len(self.scan_stamps_ns) - 1
        self.keyframes.append(
            Keyframe(len(self.keyframes), index, scan, prepared, odom_T_base, travelled)
        )
        self._interval = interval_after(prepared, self.config.keyframes)
        self._path_m = self._path_rad = self._peak_speed = self._peak_rate = 0.0

    def _record_decision(
        self, scan: LaserScan, reason: str, moved: Pose2, tracked: Tracked | None
    ) -> None:
        complexity = self._interval.complexity
        sigmas: tuple[float, ...] = ()
        if tracked is not None and tracked.match_trusted:
            sigmas = tracked.result.sigmas
        self.decisions.append(
            KeyframeDecision(
                scan.stamp_ns,
                len(self.keyframes),
                len(self.scan_stamps_ns) - 1,
                reason,
                "",
                float(np.hypot(moved.x(), moved.y())),
                abs(moved.theta()),
                float(self._interval.length),
                complexity.t_pe if complexity else float("nan"),
                complexity.sums if complexity else (),
                sigmas,
            )  # fmt: skip
        )

    def _record_edge(self, stamp_ns: int, edge: Edge, used: bool, note: str) -> None:
        floor = 1e-9 * np.eye(3)  # a blind axis has no covariance to write down
        covariance = np.linalg.inv(edge.information + floor)
        self.factors.append(
            FactorRecord(
                stamp_ns,
                edge.kind,
                edge.i,
                edge.j,
                edge.i_T_j.x(),
                edge.i_T_j.y(),
                edge.i_T_j.theta(),
                tuple(covariance.ravel().tolist()),
                used,
                note,
            )  # fmt: skip
        )

    def _record_estimate(self, stamp_ns: int, lost: bool) -> None:
        assert self.graph is not None
        k = len(self.keyframes) - 1
        x, y, theta = (float(v) for v in self.graph.poses[k])
        covariance = tuple(self.graph.marginal(k).ravel().tolist())
        self.estimates.append(PoseEstimate(stamp_ns, x, y, theta, covariance, lost))
