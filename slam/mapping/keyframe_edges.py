"""Links from a new keyframe to those before it: the match's word and the wheels', weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.pose_graph import Edge, PoseGraph
from slam.backend.pruning import Renumbered
from slam.frontend.match_types import Prior, Reference
from slam.frontend.scan import PreparedScan
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe
from slam.mapping.odometry_faults import FaultDetector, OdometryFault, Step
from slam.mapping.registration import Registration, register, starts_in_doubt
from slam.mapping.scan_sync import ZERO_BIAS, OdometryIncrement, StampedScan

SURE = 0.7  # share of beams that fit a match which convicts the wheels beyond its own step


@dataclass(frozen=True, eq=False, slots=True)
class KeyframeEdges:
    """What ties a keyframe to the one before."""

    step: Pose2  # last_T_new by the match, or by the wheels where it is not trusted
    edges: list[tuple[Edge, bool]]  # of odometry and match, and whether each is used
    note: str  # what was refused, and why
    fault: OdometryFault | None  # that this keyframe makes evident


class KeyframeEdgeBuilder:
    """Tracks keyframes one after the other and remembers what went wrong on the way."""

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._faults = FaultDetector(config.odometry, config.registration.false_alarm)
        self._unbroken = 0  # keyframes from here on are tied together by matches
        self._last_step: tuple[Pose2, float] | None = None  # the last keyframe's motion, seconds

    def begin_at(self, keyframe: int) -> None:
        """Match against this keyframe and later ones alone."""
        self._unbroken = keyframe

    def renumber(self, index: Renumbered) -> None:
        """Keyframes have gone."""
        self._unbroken = index(self._unbroken)

    def register(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, increment: OdometryIncrement,
        prepared: PreparedScan, between: Sequence[StampedScan],
    ) -> Registration:  # fmt: skip
        """Match a scan that may become a keyframe against the last ones.

        Args:
            keyframes: all so far.
            graph: that holds their poses.
            increment: from the last keyframe to this scan.
            prepared: the scan.
            between: scans taken since the last keyframe.
        """
        base = graph.pose(keyframes[-1].index)
        first = max(self._unbroken, len(keyframes) - self._config.registration.references)
        references = [
            Reference(base.between(graph.pose(k.index)), k.prepared) for k in keyframes[first:]
        ]
        limits = self._config.odometry
        plausible = all(
            step.speed <= limits.max_speed and step.turn_rate <= limits.max_turn_rate
            for step in (*between, increment.last)
        )
        return register(
            references, prepared, Prior(increment.moved, self._odometry_covariance(increment)),
            starts_in_doubt(increment.moved, increment.seconds, self._last_step), plausible,
            self._goes_on(increment.moved), self._config.registration, self._config.matcher,
        )  # fmt: skip

    def _goes_on(self, moved: Pose2) -> bool:
        """Whether the robot moves on the way it went before, forwards or backwards."""
        last = self._last_step
        return last is not None and last[0].x() * moved.x() + last[0].y() * moved.y() > 0.0

    def link(
        self, increment: OdometryIncrement, registration: Registration, new: int
    ) -> KeyframeEdges:
        """Factors of odometry and match to keyframe `new`; what is refused is told, not used."""
        information = np.asarray(np.linalg.inv(self._odometry_covariance(increment)), np.float64)
        note = registration.note
        blind = (
            registration.result.degenerate_direction is not None
        )  # the match alone would tie nothing there
        if not (registration.match_trusted and registration.odometry_trusted):
            # Nothing vouches for the odometry, or something speaks against it: it says little.
            information = information / self._config.lost_inflation**2
            note = f"lost: {note}" if registration.lost else note
        # A part of a refuted stretch needs no odometry, as long as its own match holds it.
        bias = increment.bias != ZERO_BIAS and registration.match_trusted and not blind
        if bias and registration.odometry_trusted:
            note = "odometry refused: as part of a longer stretch"
        if fault := self._fault(increment, registration):
            note = f"{fault}; {note}" if note else fault
        odometry = Edge("odometry", new - 1, new, increment.moved, information)
        result = registration.result
        matched = Edge("icp", new - 1, new, result.target_T_source, result.information)
        if not registration.match_trusted:
            self._unbroken = new
        step = result.target_T_source if registration.match_trusted else increment.moved
        self._last_step = (step, increment.seconds)
        edges = [
            (odometry, (registration.odometry_trusted and not bias) or registration.lost or blind),
            (matched, registration.match_trusted),
        ]
        return KeyframeEdges(step, edges, note, fault)

    def suspected_bias(
        self, increment: OdometryIncrement, registration: Registration
    ) -> tuple[float, float]:
        """By how much (m/s, rad/s) the odometry may lie within a stretch that is to be halved.

        Where a good match of the whole refutes it, a lie of that size is spread over its parts. In
        each of them it may be too small to be noticed, and would still pull the match along.
        """
        sure = registration.match_trusted and registration.result.inlier_fraction >= SURE
        if registration.odometry_trusted or not sure:
            return increment.bias
        error = increment.moved.between(registration.result.target_T_source)
        way, turn = float(np.hypot(error.x(), error.y())), abs(error.theta())
        known = increment.bias
        return max(known[0], way / increment.seconds), max(known[1], turn / increment.seconds)

    def _odometry_covariance(self, increment: OdometryIncrement) -> NDArray[np.float64]:
        way, turn = increment.bias
        covariance = self._config.odometry.covariance(
            increment.path_m, increment.path_rad, increment.seconds
        )
        return covariance + np.diag(np.array([way, way, turn]) * increment.seconds) ** 2

    def _fault(
        self, increment: OdometryIncrement, registration: Registration
    ) -> OdometryFault | None:
        """What the odometry is caught at by this keyframe, if anything."""
        if not registration.match_trusted:
            self._faults.forget()
            return None
        step = Step.of(increment.moved, registration.result, increment.seconds)
        return self._faults.watch(step, not registration.odometry_trusted)
