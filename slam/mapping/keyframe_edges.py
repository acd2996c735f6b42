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
from slam.mapping.odometry_faults import LieDetector, OdometryLie, Step
from slam.mapping.registration import Tracked, starts_in_doubt, track
from slam.mapping.scan_sync import HONEST, Sighting, Stretch

SURE = 0.7  # share of beams that fit a match which convicts the wheels beyond its own step


@dataclass(frozen=True, eq=False, slots=True)
class Link:
    """What ties a keyframe to the one before."""

    step: Pose2  # last_T_new by the match, or by the wheels where it is not trusted
    edges: list[tuple[Edge, bool]]  # of odometry and match, and whether each is used
    note: str  # what was refused, and why
    lie: OdometryLie | None  # that this keyframe makes evident


class Linker:
    """Tracks keyframes one after the other and remembers what went wrong on the way."""

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._lies = LieDetector(config.odometry, config.tracking.false_alarm)
        self._unbroken = 0  # keyframes from here on are tied together by matches
        self._last_step: tuple[Pose2, float] | None = None  # the last keyframe's motion, seconds

    def begin_at(self, keyframe: int) -> None:
        """Match against this keyframe and later ones alone."""
        self._unbroken = keyframe

    def renumber(self, index: Renumbered) -> None:
        """Keyframes have gone."""
        self._unbroken = index(self._unbroken)

    def track(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, stretch: Stretch,
        prepared: PreparedScan, between: Sequence[Sighting],
    ) -> Tracked:  # fmt: skip
        """Match a scan that may become a keyframe against the last ones.

        Args:
            keyframes: all so far.
            graph: that holds their poses.
            stretch: from the last keyframe to this scan.
            prepared: the scan.
            between: scans taken since the last keyframe.
        """
        base = graph.pose(keyframes[-1].index)
        first = max(self._unbroken, len(keyframes) - self._config.tracking.references)
        references = [
            Reference(base.between(graph.pose(k.index)), k.prepared) for k in keyframes[first:]
        ]
        limits = self._config.odometry
        plausible = all(
            step.speed <= limits.max_speed and step.turn_rate <= limits.max_turn_rate
            for step in (*between, stretch.last)
        )
        return track(
            references, prepared, Prior(stretch.moved, self._odometry_covariance(stretch)),
            starts_in_doubt(stretch.moved, stretch.seconds, self._last_step), plausible,
            self._goes_on(stretch.moved), self._config.tracking, self._config.matcher,
        )  # fmt: skip

    def _goes_on(self, moved: Pose2) -> bool:
        """Whether the robot moves on the way it went before, forwards or backwards."""
        last = self._last_step
        return last is not None and last[0].x() * moved.x() + last[0].y() * moved.y() > 0.0

    def link(self, stretch: Stretch, tracked: Tracked, new: int) -> Link:
        """Factors of odometry and match to keyframe `new`; what is refused is told, not used."""
        information = np.asarray(np.linalg.inv(self._odometry_covariance(stretch)), np.float64)
        note = tracked.note
        blind = tracked.result.weak_axis is not None  # the match alone would tie nothing there
        if not (tracked.match_trusted and tracked.odometry_trusted):
            # Nothing vouches for the odometry, or something speaks against it: it says little.
            information = information / self._config.lost_inflation**2
            note = f"lost: {note}" if tracked.lost else note
        # A part of a refuted stretch needs no odometry, as long as its own match holds it.
        suspected = stretch.suspected != HONEST and tracked.match_trusted and not blind
        if suspected and tracked.odometry_trusted:
            note = "odometry refused: as part of a longer stretch"
        if lie := self._lie(stretch, tracked):
            note = f"{lie}; {note}" if note else lie
        odometry = Edge("odometry", new - 1, new, stretch.moved, information)
        result = tracked.result
        matched = Edge("icp", new - 1, new, result.target_T_source, result.information)
        if not tracked.match_trusted:
            self._unbroken = new
        step = result.target_T_source if tracked.match_trusted else stretch.moved
        self._last_step = (step, stretch.seconds)
        edges = [
            (odometry, (tracked.odometry_trusted and not suspected) or tracked.lost or blind),
            (matched, tracked.match_trusted),
        ]
        return Link(step, edges, note, lie)

    def suspicion(self, stretch: Stretch, tracked: Tracked) -> tuple[float, float]:
        """By how much (m/s, rad/s) the odometry may lie within a stretch that is to be halved.

        Where a good match of the whole refutes it, a lie of that size is spread over its parts. In
        each of them it may be too small to be noticed, and would still pull the match along.
        """
        sure = tracked.match_trusted and tracked.result.quality >= SURE
        if tracked.odometry_trusted or not sure:
            return stretch.suspected
        error = stretch.moved.between(tracked.result.target_T_source)
        way, turn = float(np.hypot(error.x(), error.y())), abs(error.theta())
        known = stretch.suspected
        return max(known[0], way / stretch.seconds), max(known[1], turn / stretch.seconds)

    def _odometry_covariance(self, stretch: Stretch) -> NDArray[np.float64]:
        way, turn = stretch.suspected
        covariance = self._config.odometry.covariance(
            stretch.path_m, stretch.path_rad, stretch.seconds
        )
        return covariance + np.diag(np.array([way, way, turn]) * stretch.seconds) ** 2

    def _lie(self, stretch: Stretch, tracked: Tracked) -> OdometryLie | None:
        """What the odometry is caught at by this keyframe, if anything."""
        if not tracked.match_trusted:
            self._lies.forget()
            return None
        step = Step.of(stretch.moved, tracked.result, stretch.seconds)
        return self._lies.watch(step, not tracked.odometry_trusted)
