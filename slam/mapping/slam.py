"""The mapping algorithm: one step function for the robot and for the replay.

No file, device, clock, thread or print in here: equal messages give equal graphs, bit for bit.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.edges import Edge
from slam.backend.pose_graph import PoseGraph
from slam.frontend.deskew import deskew
from slam.frontend.scan import PreparedScan
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.mapping.calibration import Corrector
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe, preparer
from slam.mapping.keyframe_edges import KeyframeEdgeBuilder
from slam.mapping.keyframe_selection import KeyframeSelector, Planned
from slam.mapping.laser_odometry import LaserOdometry
from slam.mapping.loop_closing import MIN_GAIN, LoopCloser
from slam.mapping.loop_worker import Submit, run_inline
from slam.mapping.pruning import Pruner
from slam.mapping.records import Records, decision_record, estimate_record
from slam.mapping.registration import Registration
from slam.mapping.relocalise import PriorMap, relocalise
from slam.mapping.scan_checks import BeamTiming, NothingCode
from slam.mapping.scan_history import ScanHistory
from slam.mapping.scan_priors import PredictedPoses, predict_poses
from slam.mapping.scan_sync import (
    OdometryIncrement,
    ScanSync,
    ScanWithOdometry,
    StampedScan,
    next_stamped_scan,
)
from slam.mapping.stage_timer import NullTimer
from slam.mapping.sweep_timing import SweepTiming

MATCHES_A_STEP = 2  # keyframes tried in one step; more would delay the robot's live pose
CLOSING_SCANS = 10  # scans after which a loop search must be done, if no keyframe comes before
BYPASS = "bypasses pruned keyframes"
BACKWARDS = "scan with a stamp that runs backwards"
WRONG_TIMING = "scan whose beam times contradict its period, not corrected for motion"
CODED = "beams whose largest range stands for no return"
BROKEN = "break in the track, which only closures can join"
NOT_USED = "odometry that is not used: the map is made by the laser alone"
STALE = "odometry older than its stamp, left out"
GAP_NS = 1_000_000_000  # between two scans, beyond which the laser missed something
READMITTED = "accepted: refused along the way, but the whole graph agrees"


@dataclass(frozen=True, eq=False, slots=True)
class FinalMap:
    """The keyframes of a run whose input has ended, and where its scans are predicted to be."""

    poses: NDArray[np.float64]  # (n, 3) map_T_base of the keyframes
    edges: list[Edge]
    informations: list[NDArray[np.float64]]  # (3, 3) of each edge, as optimised
    scans: PredictedPoses  # of all scans
    covariances: NDArray[np.float64]  # (scans, 3, 3) of the keyframe before each, in its own frame


class Slam:
    """Messages in, a pose graph out.

    Loop searches run in the background through `submit`; their results enter the graph at a scan
    that is fixed in advance, so the graph does not depend on how fast they are.
    """

    def __init__(
        self, config: SlamConfig, timer: NullTimer | None = None, submit: Submit = run_inline
    ) -> None:
        self.config = config
        self._timer = timer or NullTimer()
        self.keyframes: list[Keyframe] = []
        self.scans = ScanHistory()
        self.records = Records()
        self.lost: Counter[str] = Counter()  # data that could not be used, per cause
        self.noted: Counter[str] = Counter()  # oddities that cost nothing, per cause
        self.odometry_faults: Counter[str] = Counter()  # and gaps between scans, per kind
        self.matches = 0
        self.faulty_scans: set[int] = set()  # of keyframes to which the odometry does not lead
        self.extrinsics = config.calibration.mount(LaserExtrinsics(0, 0.0, 0.0, 0.0))
        self.odometry: WheelOdometry | None = None  # the newest reading, corrected
        self._corrected = Corrector(config.calibration)
        self.graph: PoseGraph | None = None
        self.loops = LoopCloser(config.loops, config.matcher, submit)
        self._prepare = preparer(config.scan)
        self._closing_due: int | None = None  # scan at which the loop search's result enters
        self._selector = KeyframeSelector(config)
        self._edge_builder = KeyframeEdgeBuilder(config)
        self._pruner = Pruner(config.pruning, config.loops.min_path_m, submit)
        self._timing = BeamTiming()
        self.sweeps = SweepTiming(config.matcher, self._prepare)
        self.nothing_code = NothingCode()
        self._sync = ScanSync(config.scan.deskew)
        use = config.odometry.use
        self._laser_odometry = None if use else LaserOdometry(config, self._prepare)
        self._latest: StampedScan | None = None
        self._kept: StampedScan | None = None  # the last keyframe's
        self._planned: list[Planned] = []  # keyframes to come, the next one last
        self._prior_map: PriorMap | None = None
        self._searched_m: float | None = None  # path at which the prior map was last searched

    def resume(self, prior_map: PriorMap) -> None:
        """Continue a map made before; called before the first message."""
        self._prior_map = prior_map
        self.extrinsics = prior_map.extrinsics
        self.keyframes = list(prior_map.keyframes)
        sweep = (0.0, 0.0, 0.0) if self.config.scan.deskew else None  # it was taken out before
        for k in prior_map.keyframes:
            self.scans.append(k.scan.stamp_ns, k.odom_T_base, sweep)
        self.records.factors = list(prior_map.factors)
        self.records.decisions = list(prior_map.decisions)
        self._pruner.begin_at(len(prior_map.keyframes))
        self.graph = PoseGraph.restored(prior_map.poses, prior_map.edges, self.config.graph)

    @property
    def not_relocalised(self) -> bool:
        """A prior map is to be continued, and the robot has not been found in it yet."""
        return self._prior_map is not None and self._kept is None

    @property
    def waiting_scans(self) -> int:
        """How many scans wait for odometry after them."""
        return len(self._sync)

    @property
    def latest_scan(self) -> LaserScan | None:
        """The newest scan that has its odometry; None before the first."""
        return self._latest.scan if self._latest else None

    def step(self, message: Message) -> None:
        """Take in one message, in the order of the log."""
        message = self._corrected(message)
        if isinstance(message, LaserScan):
            self._sync.add_scan(self._checked(message))
        elif isinstance(message, WheelOdometry):
            self.odometry = message
            if self._laser_odometry is not None:
                self.noted[NOT_USED] += 1
            elif not self._sync.add_odometry(message):
                self.lost["odometry with a stamp that runs backwards"] += 1
            if self._sync.stale:
                self.noted[STALE] = self._sync.stale
        elif isinstance(message, LaserExtrinsics):
            self.extrinsics = message
        else:
            return
        self._drain(wait=True)

    def _checked(self, scan: LaserScan) -> LaserScan:
        """The scan without what its driver says wrongly."""
        scan = self._timing.checked(scan) if self.config.scan.deskew else scan
        if self._timing.contradicted:
            self.noted[WRONG_TIMING] = self._timing.contradicted
        scan = self.nothing_code.removed(scan)
        if self.nothing_code.beams:
            self.noted[CODED] = self.nothing_code.beams
        return scan

    def finish_input(self) -> None:
        """No more messages will come: use what still waits."""
        self._sync.finish()
        self._drain(wait=False)
        self._close_loops()
        self.loops.finish()

    def finalise(self) -> FinalMap:
        """Optimise everything in one batch; the whole graph judges every closure anew.

        What it contradicts is removed.  What was refused along the way, when an earlier closure or
        a wrong match may have bent the graph, is accepted if the rest agrees after all.

        Raises:
            GraphError: the optimiser gave up.
        """
        graph = self.graph
        assert graph is not None, "no keyframe was made"
        given, refused = len(graph.edges), self.loops.rejected
        tried = [*graph.edges, *(candidate.edge for candidate in refused)]
        final = graph.finalise([candidate.edge for candidate in refused])
        judged: dict[tuple[int, int], tuple[bool, str]] = {}
        for k, candidate in enumerate(refused, start=given):
            used, edge = k not in final.removed, candidate.edge
            note = READMITTED if used else candidate.refusal
            self.records.add_edge(candidate.stamp_ns, edge, used, note)
            judged[edge.i, edge.j] = used, note
        for k, note in sorted(final.removed.items()):
            judged.setdefault((tried[k].i, tried[k].j), (False, note))
        self.records.judge_loops(judged)
        self.loops.judge(judged)
        return self._final_map(final.edges, final.informations)

    def place_history(
        self, poses: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Where keyframes are and pruned ones were, as `FormerPlaces.joined` gives it."""
        return self._pruner.places.joined(self.keyframes, poses)

    def predicted_scans(self, poses: NDArray[np.float64]) -> PredictedPoses:
        """Where all scans are, with the keyframes at `poses` (n, 3)."""
        scans, places, _ = self.place_history(poses)
        return predict_poses(self.scans.odom_poses, scans, places, self.faulty_scans)

    def _final_map(self, edges: list[Edge], informations: list[NDArray[np.float64]]) -> FinalMap:
        assert self.graph is not None
        marginals, poses = self.graph.marginals(), self.graph.poses.copy()
        predicted, owners = self.predicted_scans(poses), self.place_history(poses)[2]
        return FinalMap(poses, edges, informations, predicted, marginals[owners[predicted.before]])

    def _drain(self, wait: bool) -> None:
        matches = 0
        while True:
            while self._planned:
                if wait and matches == MATCHES_A_STEP:
                    return
                matches += 1
                self._advance(self._planned.pop())
            paired = self._next(wait)
            if paired is None:
                return
            if paired.late:
                self.lost["scan without odometry in time"] += 1
            self._take(paired)

    def _next(self, wait: bool) -> ScanWithOdometry | None:
        """The next scan and where the odometry, or the laser alone, has it."""
        if self._laser_odometry is None:
            paired = self._sync.next(wait)
            if paired is None or self._sync.has_odometry:
                return paired
            self._laser_odometry = LaserOdometry(self.config, self._prepare)
            return self._laser_odometry.place(paired.scan, self.extrinsics, self.sweeps.order)
        scan = self._sync.pop()
        if scan is None:
            return None
        return self._laser_odometry.place(scan, self.extrinsics, self.sweeps.order)

    @property
    def laser_only(self) -> bool:
        """The map is made without odometry."""
        return self._laser_odometry is not None

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
            self.sweeps.watch(scan, self.extrinsics, odom_T_base, paired.moved)
            scan = deskew(scan, self.extrinsics, paired.moved, self.sweeps.order)
        self._latest = next_stamped_scan(
            scan, odom_T_base, len(self.scans), self._latest, paired.unknown_s, paired.broken_s
        )
        sweep = paired.moved if self.config.scan.deskew else None
        self.scans.append(scan.stamp_ns, odom_T_base, sweep)
        self._consider(self._latest)
        if self.not_relocalised:  # nobody knows where it was taken
            self.scans.pop()
            self.lost["scan before the robot was found in the map"] += 1

    def _consider(self, stamped: StampedScan) -> None:
        """Plan to make the scan a keyframe, or keep it among those between two keyframes."""
        if self._closing_due is not None and stamped.index >= self._closing_due:
            self._close_loops()
        if self._kept is None:
            prepared = self._prepare(stamped.scan, self.extrinsics)
            if prepared.valid < self.config.matcher.min_pairs:
                return
            if self._prior_map is None:
                self._begin(stamped, prepared)
            else:
                self._continue(stamped, prepared, self._prior_map)
            return
        increment = OdometryIncrement(self._kept, stamped)
        if planned := self._selector.offer(increment, self.keyframes[-1]):
            self._planned.append(planned)

    def _begin(self, stamped: StampedScan, prepared: PreparedScan) -> None:
        """Make the first keyframe."""
        self.graph = PoseGraph(Pose2(), self.config.graph)
        self._record_decision(stamped, "first", Pose2(), None)
        self._keep(stamped, prepared, 0.0)

    def _continue(self, stamped: StampedScan, prepared: PreparedScan, prior_map: PriorMap) -> None:
        """Connect the first keyframe to the prior map, once its place there is found."""
        assert self.graph is not None
        searched_m = self._searched_m
        if searched_m is not None and stamped.path_m - searched_m <= self.config.loops.every_m:
            return
        self._searched_m = stamped.path_m
        edge = relocalise(prepared, self.keyframes, self.graph, prior_map.start, self.config)
        if edge is None:
            return
        self.graph.add_keyframe(self.graph.pose(edge.i) * edge.i_T_j, [edge])
        self._edge_builder.begin_at(edge.j)
        self.records.add_edge(stamped.scan.stamp_ns, edge, True, "found in the map made before")
        self._record_decision(stamped, "resumed", Pose2(), None)
        # As far on as makes the whole prior map old enough for loops.
        self._keep(stamped, prepared, self.config.loops.min_path_m)
        self._record_estimate(stamped.scan.stamp_ns, False)

    def _advance(self, planned: Planned) -> None:
        """Make a keyframe; where match and odometry disagree, go there by a scan in between.

        A shorter interval has more overlap and less odometry: halving it until both agree, or
        no scan is left between, is what keeps the track when the odometry is wrong.  After a long
        fault that can be dozens of keyframes: they are left to the next steps, while scans wait.
        """
        stamped, between = planned.stamped, planned.between
        prepared = self._prepare(stamped.scan, self.extrinsics)
        if prepared.valid < self.config.matcher.min_pairs:
            self.noted["keyframe postponed: scan too empty"] += 1
            return
        self._close_loops()
        assert self.graph is not None
        assert self._kept is not None
        increment = OdometryIncrement(self._kept, stamped, planned.bias)
        with self._timer("matching"):
            registration = self._edge_builder.register(
                self.keyframes, self.graph, increment, prepared, between
            )
        self.matches += 1
        if between and not (registration.odometry_trusted and registration.match_trusted):
            middle = len(between) // 2
            bias = self._edge_builder.suspected_bias(increment, registration)
            self._planned += [
                Planned(stamped, planned.reason, between[middle + 1 :], bias),
                Planned(between[middle], "halved", between[:middle], bias),
            ]
            return
        self._extend(increment, prepared, registration, planned.reason)

    def _extend(
        self, increment: OdometryIncrement, prepared: PreparedScan, registration: Registration,
        reason: str,
    ) -> None:  # fmt: skip
        """Put a registered keyframe into the graph, and begin what is due after it."""
        assert self.graph is not None
        new, stamped = len(self.keyframes), increment.last
        stamp_ns = stamped.scan.stamp_ns
        if not registration.odometry_trusted:
            self.faulty_scans.add(stamped.index)
        if registration.broken:
            self.noted[BROKEN] += 1
        found = self._edge_builder.edges(increment, registration, new)
        if found.fault:
            self.odometry_faults[found.fault] += 1
        with self._timer("optimising"):
            used = [edge for edge, used in found.edges if used]
            self.graph.add_keyframe(self.graph.pose(new - 1) * found.last_T_new, used)
        for edge, is_used in found.edges:
            self.records.add_edge(stamp_ns, edge, is_used, found.note)
        self._record_decision(stamped, reason, increment.moved, registration)
        step = found.last_T_new
        self._keep(stamped, prepared, float(np.hypot(step.x(), step.y())))
        self._record_estimate(stamp_ns, registration.lost)
        with self._timer("closing"):
            begun = self.loops.begin(self.keyframes, self.graph)
        if not begun:
            with self._timer("pruning"):
                begun = self._pruner.begin(self.keyframes, self.graph, self.faulty_scans)
        if begun:
            self._closing_due = stamped.index + CLOSING_SCANS

    def _close_loops(self) -> None:
        """Add what the last loop search found to the graph, which has not grown since.

        Or, if the graph was pruned in the background instead, replace it by the smaller one.
        """
        if self._closing_due is None or self.graph is None:
            return
        self._closing_due = None
        self._take_pruned_graph()
        refused_before = len(self.loops.rejected)
        with self._timer("closing"):
            closures = self.loops.close(self.keyframes, self.graph)
        informative = [closure.edge for closure in closures if closure.gain >= MIN_GAIN]
        if informative:
            with self._timer("optimising"):
                self.graph.add_edges(informative)
            self.loops.moved()
        self.graph.add_edges_batch([c.edge for c in closures if c.gain < MIN_GAIN])
        judged = [*closures, *self.loops.rejected[refused_before:]]
        self._pruner.add_closures(candidate.edge for candidate in judged)
        for closure in closures:
            self.records.add_edge(self.keyframes[-1].scan.stamp_ns, closure.edge, True, "")

    def _take_pruned_graph(self) -> None:
        """Continue without the redundant keyframes; only where they were is remembered."""
        assert self.graph is not None
        with self._timer("pruning"):
            made = self._pruner.take(self.keyframes, self.graph)
        if made is None:
            return
        self.graph, pruned = made
        index = pruned.index
        self.records.forget(self.keyframes, index)
        self.records.pruned_counts += self.loops.renumber(index)
        left = [k for k in self.keyframes if index.stays[k.index]]
        self.keyframes = [replace(k, index=new) for new, k in enumerate(left)]
        self._edge_builder.renumber(index)
        for edge in pruned.made:
            self.records.add_edge(self.keyframes[edge.j].scan.stamp_ns, edge, True, BYPASS)

    def _keep(self, stamped: StampedScan, prepared: PreparedScan, step_m: float) -> None:
        """Append a keyframe that is `step_m` of path after the one before."""
        last = self.keyframes[-1] if self.keyframes else None
        keyframe = Keyframe(
            index=len(self.keyframes),
            scan_index=stamped.index,
            scan=stamped.scan,
            extrinsics=self.extrinsics,
            prepare=self._prepare,
            centre=prepared.centre,
            odom_T_base=stamped.odom_T_base,
            travelled_m=step_m + (last.travelled_m if last else 0.0),
            number=last.number + 1 if last else 0,
        )
        self.keyframes.append(keyframe)
        self._selector.restart(keyframe)
        self._kept = stamped

    def _record_decision(
        self, stamped: StampedScan, reason: str, moved: Pose2, registration: Registration | None
    ) -> None:
        self.records.decisions.append(
            decision_record(
                stamped.scan, len(self.keyframes), stamped.index, reason, moved,
                self._selector.interval, registration,
            )
        )  # fmt: skip

    def _record_estimate(self, stamp_ns: int, lost: bool) -> None:
        assert self.graph is not None
        self.records.estimates.append(
            estimate_record(stamp_ns, self.graph, len(self.keyframes) - 1, lost)
        )
