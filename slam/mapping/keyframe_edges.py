"""Edges from a new keyframe to the one before: the scan match and the wheel odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.pose_graph import Edge, PoseGraph
from slam.backend.pruned_graph import Renumbered
from slam.frontend.match_types import Prior, Reference
from slam.frontend.scan import PreparedScan
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe
from slam.mapping.match_starts import starts_in_doubt
from slam.mapping.odometry_faults import FaultDetector, OdometryFault, Step
from slam.mapping.registration import (
    AFTER_FAULT,
    FAULTS_BEFORE,
    NEVER,
    STEPS_BEFORE,
    OdometryEvidence,
    Registration,
    register,
)
from slam.mapping.scan_sync import STAMP_JITTER_S, ZERO_BIAS, OdometryIncrement, StampedScan

# One sigma of how a robot moves that nothing is known of.
USUAL_SPEED, USUAL_TURN_RATE = 0.5, 0.5  # m/s, rad/s
# Rate at which robots are picked up and carried: once in some hours of work.
CARRIED_PER_S = 1e-4
# Mean speed of wheels that stand still for most of the time.
AT_REST_SPEED, AT_REST_TURN_RATE = 0.1, 0.1  # m/s, rad/s
# Across a break only closures tell where the new piece is: within a building, facing anywhere.
BREAK_INFORMATION = np.diag([1 / 20.0**2, 1 / 20.0**2, 1 / math.pi**2])  # 1/m^2, 1/m^2, 1/rad^2
AS_EXACT = 1.5  # factor in sigmas within which the odometry of a longer way is as exact


@dataclass(frozen=True, eq=False, slots=True)
class KeyframeEdges:
    """What constrains a keyframe relative to the one before."""

    last_T_new: Pose2  # by the match, or by the odometry where the match is not trusted
    edges: list[tuple[Edge, bool]]  # of odometry and match, and whether each is used
    note: str  # what was refused, and why
    fault: OdometryFault | None  # that this keyframe makes evident


class KeyframeEdgeBuilder:
    """Registers keyframes one after the other and remembers what was refused on the way."""

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._faults = FaultDetector(config.odometry, config.registration.false_alarm)
        self._unbroken = 0  # keyframes from here on are connected by matches
        # Keyframes before the last one, as far back as no odometry was refused.
        self._sound: deque[StampedScan] = deque(maxlen=config.registration.references)
        self._steps_seen, self._faults_seen = 0, 0
        self._after_fault = False  # the last keyframe's odometry was refused
        self._last_step: tuple[Pose2, float] | None = None  # the last keyframe's motion, seconds

    def begin_at(self, keyframe: int) -> None:
        """Match against this keyframe and later ones alone."""
        self._unbroken = keyframe

    def renumber(self, index: Renumbered) -> None:
        """Keyframes have been pruned."""
        self._unbroken = index(self._unbroken)

    def register(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, increment: OdometryIncrement,
        prepared: PreparedScan, between: Sequence[StampedScan],
    ) -> Registration:  # fmt: skip
        """Match a scan that may become a keyframe against the last ones.

        Args:
            keyframes: all so far.
            graph: that holds their poses.
            increment: of the odometry, from the last keyframe to this scan.
            prepared: the scan.
            between: scans taken since the last keyframe.
        """
        last = graph.pose(keyframes[-1].index)
        first = max(self._unbroken, len(keyframes) - self._config.registration.references)
        references = [
            Reference(last.between(graph.pose(k.index)), k.prepared) for k in keyframes[first:]
        ]
        odometry = OdometryEvidence(
            self._prior(increment, keyframes, graph),
            starts_in_doubt(increment.moved, increment.seconds, self._last_step),
            self._config.robot.can_move([*between, increment.last]),
            self._config.robot.reach(increment.seconds + STAMP_JITTER_S),
            self._fault_rate,
            self._carried(increment),
        )
        config = self._config
        return register(references, prepared, odometry, config.registration, config.matcher)

    @property
    def _fault_rate(self) -> float:
        """Probability of a fault in the next step, by what this log has shown so far."""
        if self._after_fault:
            return AFTER_FAULT
        return (FAULTS_BEFORE + self._faults_seen) / (STEPS_BEFORE + self._steps_seen)

    def _carried(self, increment: OdometryIncrement) -> float:
        """Probability that the robot was carried meanwhile; its wheels would have stood still."""
        seconds = max(increment.seconds, STAMP_JITTER_S)
        speed, rate = increment.path_m / seconds, increment.path_rad / seconds
        if speed > AT_REST_SPEED or rate > AT_REST_TURN_RATE:
            return NEVER
        return min(CARRIED_PER_S * seconds, AFTER_FAULT)

    def _prior(
        self, increment: OdometryIncrement, keyframes: Sequence[Keyframe], graph: PoseGraph
    ) -> Prior:
        """Where the odometry has the new scan, from the farthest keyframe that says it as well.

        Each of many short steps may be off by half its length, for nobody knows to better than
        `sync` at what time it was measured; all of them together may not.
        """
        prior = Prior(increment.moved, self._odometry_covariance(increment))
        widest = AS_EXACT**2 * np.diag(prior.covariance)
        last = graph.pose(keyframes[-1].index)
        for back, earlier in enumerate(reversed(self._sound), start=2):
            longer = OdometryIncrement(earlier, increment.last, increment.bias)
            covariance = self._odometry_covariance(longer)
            if (np.diag(covariance) > widest).any():
                break
            step = last.between(graph.pose(keyframes[-back].index)) * longer.moved
            prior = Prior(step, covariance)
        return prior

    def edges(
        self, increment: OdometryIncrement, registration: Registration, new: int
    ) -> KeyframeEdges:
        """Odometry and match as edges to keyframe `new`; refused ones are recorded, not used."""
        information = np.asarray(
            np.linalg.inv(self._odometry_covariance(increment)), dtype=np.float64
        )
        result, note = registration.result, registration.note
        degenerate = result.degenerate_direction is not None  # the match alone leaves it open
        if not (registration.match_trusted and registration.odometry_trusted):
            # Nothing confirms the odometry, or something refutes it: it counts for little.
            information = information / self._config.odometry.lost_inflation**2
            note = f"lost: {note}" if registration.lost else note
        if registration.broken:
            information = BREAK_INFORMATION
        information = widened(information, registration.odometry_spread)
        matched_information = widened(result.information, registration.match_spread)
        # A part of a refuted increment needs no odometry, as long as its own match holds it.
        suspect = increment.bias != ZERO_BIAS and registration.match_trusted and not degenerate
        if suspect and registration.odometry_trusted:
            note = "odometry refused: as part of a longer increment"
        if fault := self._fault(increment, registration):
            note = f"{fault}; {note}" if note else fault
        odometry = Edge("odometry", new - 1, new, increment.moved, information)
        matched = Edge("icp", new - 1, new, result.target_T_source, matched_information)
        if not registration.match_trusted:
            self._unbroken = new
        step = result.target_T_source if registration.match_trusted else increment.moved
        self._last_step = (step, increment.seconds)
        self._sound.append(increment.first)
        if not registration.odometry_trusted:
            self._sound.clear()
        self._after_fault = registration.match_trusted and not registration.odometry_trusted
        self._steps_seen += 1
        self._faults_seen += self._after_fault
        trusted = registration.odometry_trusted and not suspect
        edges = [
            (odometry, trusted or registration.lost or degenerate),
            (matched, registration.match_trusted),
        ]
        return KeyframeEdges(step, edges, note, fault)

    def suspected_bias(
        self, increment: OdometryIncrement, registration: Registration
    ) -> tuple[float, float]:
        """By how much (m/s, rad/s) the odometry may be off within an increment that is halved.

        Where a good match of the whole refutes it, an error of that size is spread over its parts.
        In each of them it may be too small to be noticed, and would still pull the match along.
        """
        if registration.odometry_trusted or not registration.match_trusted:
            return increment.bias
        error = increment.moved.between(registration.result.target_T_source)
        distance, turn = float(np.hypot(error.x(), error.y())), abs(error.theta())
        speed, rate = increment.bias
        return max(speed, distance / increment.seconds), max(rate, turn / increment.seconds)

    def _odometry_covariance(self, increment: OdometryIncrement) -> NDArray[np.float64]:
        covariance = self._config.odometry.covariance(
            increment.path_m, increment.path_rad, increment.seconds
        )
        speed, rate = increment.bias
        off = np.array([speed, speed, rate]) * increment.seconds
        unknown = np.array([USUAL_SPEED, USUAL_SPEED, USUAL_TURN_RATE]) * increment.unknown_s
        return covariance + np.diag(off**2 + unknown**2)

    def _fault(
        self, increment: OdometryIncrement, registration: Registration
    ) -> OdometryFault | None:
        """The odometry fault that becomes evident with this keyframe, if any."""
        if not registration.match_trusted:
            self._faults.forget()
            return None
        step = Step.of(increment.moved, registration.result, increment.seconds)
        return self._faults.watch(step, not registration.odometry_trusted)


def widened(
    information: NDArray[np.float64], spread: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Information (3, 3) of a step whose error also has the covariance `spread`."""
    if spread is None:
        return information
    less: NDArray[np.float64] = information @ np.linalg.inv(np.eye(3) + spread @ information)
    return 0.5 * (less + less.T)
