"""Which scans become keyframes: the interval chosen at the last one, and the scans in between."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.frontend.information import CHAIN_CORRELATION, PredictionModel
from slam.frontend.keyframes import (
    SHORTEST_M,
    Interval,
    interval_after,
    interval_ahead,
    reason_to_keep,
)
from slam.frontend.scan import PreparedScan
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe
from slam.mapping.scan_sync import OdometryIncrement, StampedScan

MOST_BETWEEN = 64  # scans kept between two keyframes: a robot may stand for days


@dataclass(frozen=True, eq=False, slots=True)
class Planned:
    """A scan that shall become a keyframe."""

    stamped: StampedScan
    reason: str
    between: list[StampedScan]  # scans since the keyframe before
    bias: tuple[float, float]  # m/s, rad/s, as in `OdometryIncrement`


class KeyframeSelector:
    """Looks at every scan between keyframes, and says when the next one is due."""

    def __init__(self, config: SlamConfig) -> None:
        self._config = config
        self._rule = config.keyframes if config.loops.enabled else config.keyframes.open
        self.interval = Interval(0.0, None)  # to the next keyframe
        self._between: list[StampedScan] = []

    def restart(self, keyframe: Keyframe) -> None:
        """Begin the interval after a new keyframe."""
        self.interval = interval_after(self._view(keyframe), self._rule, self._model(0.0))
        self._between = []

    def offer(self, increment: OdometryIncrement, keyframe: Keyframe) -> Planned | None:
        """The scan at the end of the increment, if it shall become a keyframe.

        Args:
            increment: of the odometry, from the last keyframe to the scan.
            keyframe: the last one.
        """
        moved, seconds = increment.moved, increment.seconds
        if self.interval.open:
            self._choose_interval(moved, seconds, keyframe)
        reason = reason_to_keep(moved, increment.scans, seconds, self.interval, self._rule)
        if reason:
            return Planned(increment.last, reason, self._between, increment.bias)
        self._between.append(increment.last)
        if len(self._between) > MOST_BETWEEN:  # the robot stands still: keep every other one
            self._between = self._between[::2]
        return None

    def _choose_interval(self, moved: Pose2, seconds: float, keyframe: Keyframe) -> None:
        """Predict the next match as soon as the direction and speed of motion are known."""
        distance = float(np.hypot(moved.x(), moved.y()))
        if distance >= SHORTEST_M:
            model = self._model(distance / seconds)
            chosen = interval_ahead(self._view(keyframe), moved, model, self._rule)
            self.interval = replace(chosen, turn=self.interval.turn)

    def _view(self, keyframe: Keyframe) -> PreparedScan:
        """What the prediction is made from."""
        return keyframe.prepared

    def _model(self, speed: float) -> PredictionModel:
        """What is known of matches after driving at `speed` (m/s), or after turning on the spot."""
        config = self._config

        def odometry(metres: float, radians: float) -> NDArray[np.float64]:
            seconds = metres / speed if metres else math.inf
            return config.odometry.covariance(metres, radians, seconds)

        return PredictionModel(
            odometry, config.registration.references, config.matcher.range_noise,
            CHAIN_CORRELATION, config.scan.gap_ratio, self._rule.tolerance,
        )  # fmt: skip
