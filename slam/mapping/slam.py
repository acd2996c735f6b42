"""The pipeline: one step function for the robot and for the replay.

No file, device, clock, thread or print in here: equal messages give equal graphs, bit for bit.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.pose_graph import PoseGraph
from slam.frontend.deskew import deskew
from slam.frontend.information import PredictionModel
from slam.frontend.keyframes import Interval, interval_after, interval_ahead, reason_to_keep
from slam.frontend.scan import PreparedScan
from slam.logs.messages import (
    LaserExtrinsics,
    LaserScan,
    Message,
    WheelOdometry,
)
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe, preparer
from slam.mapping.keyframe_edges import KeyframeEdgeBuilder
from slam.mapping.loop_closing import LoopCloser
from slam.mapping.loop_worker import Submit, run_inline
from slam.mapping.pruning import Pruner
from slam.mapping.records import Records, decision_record, estimate_record
from slam.mapping.registration import Registration
from slam.mapping.relocalise import PriorMap, locate
from slam.mapping.scan_history import ScanHistory
from slam.mapping.scan_sync import (
    ZERO_BIAS,
    OdometryIncrement,
    ScanSync,
    ScanWithOdometry,
    StampedScan,
    next_stamped_scan,
)
from slam.mapping.stage_timer import NullTimer

MOST_BETWEEN = 64  # scans kept between two keyframes
MATCHES_A_STEP = 2  # keyframes tried in one step; more would hold up the robot's live pose
CLOSING_SCANS = 10  # scans after which a loop search must be done, if no keyframe comes before
PRUNED = "goes round keyframes that were thinned out"
BACKWARDS = "scan with a stamp that runs backwards"
GAP_NS = 1_000_000_000  # between two scans, beyond which the laser missed something


@dataclass(frozen=True, eq=False, slots=True)
class _Ahead:
    """A keyframe to be."""

    stamped: StampedScan
    reason: str
    between: Sequence[StampedScan]  # scans since the keyframe before
    bias: tuple[float, float]  # m/s, rad/s, as in `OdometryIncrement`


class Slam:
    """Messages in, a pose graph out.

    Loop searches run `submit` it; their results enter the graph at a scan fixed in advance, so
    it makes no difference to the graph how fast they are or whether they run beside at all.
    """

    def __init__(
        self, config: SlamConfig, watch: NullTimer | None = None, submit: Submit = run_inline
    ) -> None:
        self.config = config
        self._watch = watch or NullTimer()
        self.keyframes: list[Keyframe] = []
        self.scans = ScanHistory()
        self.records = Records()
        self.lost: Counter[str] = Counter()  # data that could not be used, per cause
        self.noted: Counter[str] = Counter()  # oddities that cost nothing, per cause
        self.odometry_faults: Counter[str] = Counter()  # lies told by the wheels, and scan gaps
        self.matches = 0
        self.odometry_faulty: set[int] = (
            set()
        )  # scans of keyframes to which the odometry did not lead
        self.extrinsics = LaserExtrinsics(0, 0.0, 0.0, 0.0)
        self.graph: PoseGraph | None = None
        self.loops = LoopCloser(config.loops, config.matcher, submit)
        self._prepare = preparer(config.scan)
        self._choice = config.keyframes if config.loops.enabled else config.keyframes.open
        self._closing_due: int | None = None  # scan at which the loop search's result enters
        self._edge_builder = KeyframeEdgeBuilder(config)
        self._pruner = Pruner(config.pruning, config.loops.min_path_m, submit)
        self._sync = ScanSync(config.scan.deskew)
        self._interval = Interval(0.0, None)
        self._latest: StampedScan | None = None
        self._kept: StampedScan | None = None  # the last keyframe's
        self._between: list[StampedScan] = []  # scans since then
        self._ahead: list[_Ahead] = []  # keyframes to be, the next one last
        self._prior_map: PriorMap | None = None
        self._sought_m: float | None = None  # way at which the place in the past was last sought

    def resume(self, prior_map: PriorMap) -> None:
        """Go on with a map made before; called before the first message."""
        self._prior_map = prior_map
        self.extrinsics = prior_map.extrinsics
        self.keyframes = list(prior_map.keyframes)
        for k in prior_map.keyframes:
            self.scans.append(k.scan.stamp_ns, k.odom_T_base)
        self.records.factors, self.records.decisions = (
            list(prior_map.factors),
            list(prior_map.decisions),
        )
        self._pruner.begin_at(len(prior_map.keyframes))
        self.graph = PoseGraph.restored(prior_map.poses, prior_map.edges, self.config.graph)

    @property
    def not_relocalised(self) -> bool:
        """The robot goes on with a map made before, and was not found in it."""
        return self._prior_map is not None and self._kept is None

    def step(self, message: Message) -> None:
        """Take in one message, in the order of the log."""
        if isinstance(message, LaserScan):
            self._sync.add_scan(message)
        elif isinstance(message, WheelOdometry):
            if not self._sync.add_odometry(message):
                self.lost["odometry with a stamp that runs backwards"] += 1
        elif isinstance(message, LaserExtrinsics):
            self.extrinsics = message
        else:
            return
        self._drain(wait=True)

    def places(
        self, poses: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Where keyframes are, and were that are thinned out, as `FormerPlaces.joined` has it."""
        return self._pruner.places.joined(self.keyframes, poses)

    @property
    def waiting_scans(self) -> int:
        """How many scans wait for odometry after them."""
        return len(self._sync)

    @property
    def latest_scan(self) -> LaserScan | None:
        """The newest scan that has its odometry; None before the first."""
        return self._latest.scan if self._latest else None

    def finish_input(self) -> None:
        """No more messages will come: use what still waits."""
        self._drain(wait=False)
        self._close_loops()
        self.loops.finish()

    def _drain(self, wait: bool) -> None:
        matches = 0
        while True:
            while self._ahead:
                if wait and matches == MATCHES_A_STEP:
                    return
                matches += 1
                self._advance(self._ahead.pop())
            paired = self._sync.next(wait)
            if paired is None:
                return
            if paired.late:
                self.lost["scan without odometry in time"] += 1
            self._take(paired)

    def _take(self, paired: ScanWithOdometry) -> None:
        """Use one scan whose odometry is known."""
        scan, odom_T_base = paired.scan, paired.odom_T_base
        if len(self.scans) and scan.stamp_ns <= self.scans.last_ns:
            self.lost[BACKWARDS] += 1
            return
        if not np.isfinite(scan.ranges).any():
            self.noted["scan without any return"] += 1
        if len(self.scans) and scan.stamp_ns - self.scans.last_ns > GAP_NS:
            self.odometry_faults["scan-gap"] += 1
        if self.config.scan.deskew:
            scan = deskew(scan, self.extrinsics, paired.moved)
        self._latest = next_stamped_scan(scan, odom_T_base, len(self.scans), self._latest)
        sweep = paired.moved if self.config.scan.deskew else None
        self.scans.append(scan.stamp_ns, odom_T_base, sweep)
        self._consider(self._latest)
        if self.not_relocalised:  # nothing says where it was taken
            self.scans.pop()
            self.lost["scan before the robot was found in the map"] += 1

    def _consider(self, stamped: StampedScan) -> None:
        """Make the scan a keyframe, or let it wait among those between two keyframes."""
        if self._closing_due is not None and stamped.index >= self._closing_due:
            self._close_loops()
        if self._kept is None:
            prepared = self._prepare(stamped.scan, self.extrinsics)
            if prepared.valid < self.config.matcher.min_pairs:
                return
            if self._prior_map is None:
                self._begin(stamped, prepared)
            else:
                self._go_on(stamped, prepared, self._prior_map)
            return
        increment = OdometryIncrement(self._kept, stamped)
        moved, seconds = increment.moved, increment.seconds
        if self._interval.open:
            self._choose_interval(moved, seconds)
        reason = reason_to_keep(moved, increment.scans, seconds, self._interval, self._choice)
        if reason:
            self._ahead.append(_Ahead(stamped, reason, self._between, ZERO_BIAS))
            return
        self._between.append(stamped)
        if len(self._between) > MOST_BETWEEN:  # the robot stands still: keep every other one
            self._between = self._between[::2]

    def _choose_interval(self, moved: Pose2, seconds: float) -> None:
        """Foresee the next match as soon as it shows where the robot goes, and how fast."""
        config, distance = self._choice, float(np.hypot(moved.x(), moved.y()))
        if distance >= config.shortest:
            model = self._prediction_model(distance / seconds)
            ahead = interval_ahead(self._predicted_from(), moved, model, config)
            self._interval = replace(ahead, turn=self._interval.turn)

    def _prediction_model(self, speed: float) -> PredictionModel:
        """What is known of matches after a way at `speed` (m/s), or after turning on the spot."""
        config = self.config

        def odometry(metres: float, radians: float) -> NDArray[np.float64]:
            seconds = metres / speed if metres else math.inf
            return config.odometry.covariance(metres, radians, seconds)

        return PredictionModel(
            odometry, config.registration.references, config.matcher.range_noise,
            config.matcher.lasting, config.scan.gap_ratio, self._choice.tolerance,
        )  # fmt: skip

    def _predicted_from(self) -> PreparedScan:
        return self.keyframes[-1].prepared

    def _go_on(self, stamped: StampedScan, prepared: PreparedScan, prior_map: PriorMap) -> None:
        """Tie the first keyframe to the map made before, once its place there is found."""
        assert self.graph is not None
        due = self._sought_m is None or stamped.path_m - self._sought_m > self.config.loops.every_m
        if not due:
            return
        self._sought_m = stamped.path_m
        edge = locate(prepared, self.keyframes, self.graph, prior_map.start, self.config)
        if edge is None:
            return
        self.graph.add_keyframe(self.graph.pose(edge.i) * edge.i_T_j, [edge])
        self._edge_builder.begin_at(edge.j)
        self.records.add_edge(stamped.scan.stamp_ns, edge, True, "found in the map made before")
        self._decide(stamped.scan, stamped.index, "resumed", Pose2(), None)
        # As far on as makes the whole old map old enough for loops.
        self._keep(stamped, prepared, self.config.loops.min_path_m)
        self._estimate(stamped.scan.stamp_ns, False)

    def _begin(self, stamped: StampedScan, prepared: PreparedScan) -> None:
        self.graph = PoseGraph(Pose2(), self.config.graph)
        self._decide(stamped.scan, stamped.index, "first", Pose2(), None)
        self._keep(stamped, prepared, 0.0)

    def _advance(self, ahead: _Ahead) -> None:
        """Add a keyframe; where match and odometry quarrel, go there by a scan in between.

        A shorter interval has more overlap and less odometry: halving it until both agree, or
        no scan is left between, is what keeps the track when the odometry lies.  After a long bad
        stretch that can be dozens of keyframes: they are left to the next steps, while scans wait.
        """
        stamped, between = ahead.stamped, ahead.between
        prepared = self._prepare(stamped.scan, self.extrinsics)
        if prepared.valid < self.config.matcher.min_pairs:
            self.noted["keyframe postponed: scan too empty"] += 1
            return
        self._close_loops()
        assert self.graph is not None
        assert self._kept is not None
        increment = OdometryIncrement(self._kept, stamped, ahead.bias)
        with self._watch("matching"):
            registration = self._edge_builder.register(
                self.keyframes, self.graph, increment, prepared, between
            )
        self.matches += 1
        if between and not (registration.odometry_trusted and registration.match_trusted):
            middle, bias = (
                len(between) // 2,
                self._edge_builder.suspected_bias(increment, registration),
            )
            self._ahead += [
                _Ahead(stamped, ahead.reason, between[middle + 1 :], bias),
                _Ahead(between[middle], "halved", between[:middle], bias),
            ]
            return
        self._extend(increment, prepared, registration, ahead.reason)

    def _extend(
        self,
        increment: OdometryIncrement,
        prepared: PreparedScan,
        registration: Registration,
        reason: str,
    ) -> None:
        """Put a tracked keyframe into the graph and look for loops."""
        assert self.graph is not None
        new, stamped = len(self.keyframes), increment.last
        if not registration.odometry_trusted:
            self.odometry_faulty.add(stamped.index)
        link = self._edge_builder.link(increment, registration, new)
        if link.fault:
            self.odometry_faults[link.fault] += 1
        with self._watch("optimising"):
            used = [edge for edge, used in link.edges if used]
            self.graph.add_keyframe(self.graph.pose(new - 1) * link.step, used)
        for edge, is_used in link.edges:
            self.records.add_edge(stamped.scan.stamp_ns, edge, is_used, link.note)
        self._decide(stamped.scan, stamped.index, reason, increment.moved, registration)
        self._keep(stamped, prepared, float(np.hypot(link.step.x(), link.step.y())))
        self._estimate(stamped.scan.stamp_ns, registration.lost)
        with self._watch("closing"):
            begun = self.loops.begin(self.keyframes, self.graph)
        if not begun:
            with self._watch("thinning"):
                begun = self._pruner.begin(self.keyframes, self.graph, self.odometry_faulty)
        if begun:
            self._closing_due = stamped.index + CLOSING_SCANS

    def _close_loops(self) -> None:
        """Let what the last loop search found enter the graph, which has not grown since.

        Or, where there was time for that instead, take the graph that was thinned out meanwhile.
        """
        if self._closing_due is None or self.graph is None:
            return
        self._closing_due = None
        self._prune()
        rejected = len(self.loops.rejected)
        with self._watch("closing"):
            closures = self.loops.close(self.keyframes, self.graph)
        least = self.config.loops.min_gain
        informative = [closure.edge for closure in closures if closure.gain >= least]
        if informative:
            with self._watch("optimising"):
                self.graph.add_edges(informative)
            self.loops.moved()
        self.graph.add_edges_batch([c.edge for c in closures if c.gain < least])
        told = [*closures, *self.loops.rejected[rejected:]]
        self._pruner.add_closures(candidate.edge for candidate in told)
        for closure in closures:
            self.records.add_edge(self.keyframes[-1].scan.stamp_ns, closure.edge, True, "")

    def _prune(self) -> None:
        """Go on as though dispensable keyframes had never been, but for where they were."""
        assert self.graph is not None
        with self._watch("thinning"):
            made = self._pruner.take(self.keyframes, self.graph)
        if made is None:
            return
        self.graph, prune = made
        index = prune.index
        self.records.forget(self.keyframes, index)
        self.records.pruned_counts += self.loops.renumber(index)
        left = [k for k in self.keyframes if index.stays[k.index]]
        self.keyframes = [replace(k, index=new) for new, k in enumerate(left)]
        self._edge_builder.renumber(index)
        for edge in prune.made:
            self.records.add_edge(self.keyframes[edge.j].scan.stamp_ns, edge, True, PRUNED)

    def _keep(self, stamped: StampedScan, prepared: PreparedScan, step_m: float) -> None:
        travelled = step_m + (self.keyframes[-1].travelled_m if self.keyframes else 0.0)
        self.keyframes.append(
            Keyframe(
                len(self.keyframes),
                stamped.index,
                stamped.scan,
                self.extrinsics,
                self._prepare,
                prepared.centre,
                stamped.odom_T_base,
                travelled,
                self.keyframes[-1].number + 1 if self.keyframes else 0,
            )
        )
        self._interval = interval_after(
            self._predicted_from(), self._choice, self._prediction_model(0.0)
        )
        self._kept = stamped
        self._between = []

    def _decide(
        self,
        scan: LaserScan,
        index: int,
        reason: str,
        moved: Pose2,
        registration: Registration | None,
    ) -> None:
        number = len(self.keyframes)
        self.records.decisions.append(
            decision_record(scan, number, index, reason, moved, self._interval, registration)
        )

    def _estimate(self, stamp_ns: int, lost: bool) -> None:
        assert self.graph is not None
        self.records.estimates.append(
            estimate_record(stamp_ns, self.graph, len(self.keyframes) - 1, lost)
        )
