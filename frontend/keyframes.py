"""Which scan becomes the next keyframe: by the walls, by information, or ever the same."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field, model_validator
from slam.frontend.complexity import PoseComplexity, pose_score, wall_profiles, wall_sums
from slam.frontend.information import (
    Prediction,
    PredictionModel,
    best_distance,
    best_turn,
    distance_of_overlap,
)
from slam.frontend.scan import PreparedScan

SHORTEST_M = 0.1  # the shortest predicted interval: nearer, a match costs more than it gains
NARROWEST_RAD = 0.1  # the narrowest predicted turn, likewise
# Where no loops are closed every error stays and adds up: a predicted error may exceed the least by
# a quarter as much, and the widest turn is four fifths (simulated drives, docs/results.md).
OPEN_TOLERANCE, OPEN_WIDEST = 0.25, 0.8


class KeyframeConfig(BaseModel):
    """Keyframe selection."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Literal["sdp-pe", "constant", "information", "overlap"] = Field(
        "sdp-pe",
        description="interval from the walls' complexity, always the same, from what a match "
        "will know, or from how much it will still see",
    )
    unit: Literal["metres", "scans"] = Field(
        "metres", description="what intervals count: travelled metres, or scans as in the paper"
    )
    interval: float = Field(0.3, gt=0, description="constant interval, in units")
    min_interval: float = Field(0.2, gt=0, description="shortest SDP-PE interval, in units")
    max_interval: float = Field(0.5, gt=0, description="longest SDP-PE interval, in units")
    # Fitted by `slam bench weights` on simulated drives (test bed, corridor, mixed, clutter; seeds
    # 1000 to 1005) to the least variance a metre, with the limits above and as many matches as a
    # constant interval of 0.3 m; left and right alike.  It found 0.203, 0.001 and 2.917; judged on
    # other seeds and worlds, these do no better than that constant (docs/results.md).
    t_low: float = Field(0.0, ge=0, description="T_PE at which the interval is the shortest")
    t_high: float = Field(2.9, gt=0, description="T_PE at which the interval is the longest")
    weights: tuple[float, float, float, float] = Field(
        (1.0, 0.2, 1.0, 0.2), description="w1 to w4 of Equation 2"
    )
    profile_reach: float = Field(4.0, gt=0, description="m of wall ahead and behind")
    profile_bin: float = Field(0.25, gt=0, description="m, grid of the wall profile")
    longest: float = Field(
        3.0, gt=SHORTEST_M, description="m, the longest predicted interval; the shortest is 0.1 m"
    )
    # A predicted sigma is right to about a tenth (0.05 to 0.16 in the median over the simulated
    # worlds), so no choice is better than that; but in an open chain every error stays and adds up.
    tolerance: float = Field(
        0.1, ge=0, description="share by which a predicted error may exceed the least, for longer "
        "intervals; where loops are off, a quarter of it",
    )  # fmt: skip
    least_overlap: float = Field(
        0.7, gt=0, lt=1, description="share of the view that method overlap keeps"
    )
    max_turn: float = Field(
        0.3, gt=0, description="rad, a larger turn makes a keyframe; method information predicts it"
    )
    widest: float = Field(
        1.0, gt=NARROWEST_RAD / OPEN_WIDEST,
        description="rad, the widest predicted turn; where loops are off, four fifths of it",
    )  # fmt: skip
    max_time: float = Field(
        10.0, gt=0, description="s, the longest wait while the robot moves at all"
    )
    still: float = Field(0.02, ge=0, description="m or rad below which the robot stands still")

    @model_validator(mode="after")
    def _ordered(self) -> KeyframeConfig:
        if self.min_interval > self.max_interval:
            raise ValueError("min_interval must not exceed max_interval")
        if self.t_low >= self.t_high:
            raise ValueError("t_low must be below t_high")
        if self.predicts and self.unit != "metres":
            raise ValueError(f"method {self.method} gives metres: unit must be metres")
        return self

    @property
    def open(self) -> KeyframeConfig:
        """The settings for a chain of keyframes whose loops are not closed."""
        values = {
            "tolerance": OPEN_TOLERANCE * self.tolerance,
            "widest": OPEN_WIDEST * self.widest,
        }
        return self.model_copy(update=values)

    @property
    def predicts(self) -> bool:
        """Whether the interval depends on where the robot goes, and waits for its first motion."""
        return self.method in ("information", "overlap")


@dataclass(frozen=True, slots=True)
class Interval:
    """How far the robot may go from a keyframe, and why."""

    length: float  # in the configured unit
    complexity: PoseComplexity | None  # None where the method does not look at the walls
    prediction: Prediction | None = None  # None where it does not foresee the match
    open: bool = False  # to be chosen when the robot has begun to move
    turn: float | None = None  # rad; None: as configured


def interval_after(
    keyframe: PreparedScan, config: KeyframeConfig, model: PredictionModel | None = None
) -> Interval:
    """The interval from this keyframe to the next, as far as it is known before the robot moves.

    SDP-PE: the more complex the walls, the less overlap a match needs, the longer the interval.
    The paper gives no mapping from T_PE to the interval; it is taken as linear between two
    clamps, the simplest monotone one.
    """
    if config.method == "constant":
        return Interval(config.interval, None)
    if config.predicts:
        turn = None
        if config.method == "information" and model is not None:
            turn = best_turn(keyframe, NARROWEST_RAD, config.widest, model)
        return Interval(config.longest, None, open=True, turn=turn)
    left, right = wall_profiles(keyframe.points, config.profile_reach, config.profile_bin)
    complexity = pose_score(wall_sums(left), wall_sums(right), config.weights)
    share = (complexity.t_pe - config.t_low) / (config.t_high - config.t_low)
    share = min(max(share, 0.0), 1.0)
    length = config.min_interval + share * (config.max_interval - config.min_interval)
    return Interval(length, complexity)


def interval_ahead(
    keyframe: PreparedScan, moved: Pose2, model: PredictionModel, config: KeyframeConfig
) -> Interval:
    """The interval of a method that foresees the match, once it is known where the robot goes.

    Args:
        keyframe: the last one.
        moved: keyframe_T_now by odometry; the robot is taken to go on in that direction.
        model: what is known about the matches to come.
        config: method and limits.
    """
    direction = math.atan2(moved.y(), moved.x())
    if config.method == "overlap":
        length = distance_of_overlap(
            keyframe, direction, SHORTEST_M, config.longest, config.least_overlap, model
        )
        return Interval(length, None)
    prediction = best_distance(keyframe, direction, SHORTEST_M, config.longest, model)
    return Interval(prediction.distance, None, prediction)


def reason_to_keep(
    moved: Pose2, scans: int, seconds: float, interval: Interval, config: KeyframeConfig
) -> str:
    """Why the current scan should become a keyframe; empty if it should not.

    Args:
        moved: last-keyframe_T_now by odometry.
        scans: since the last keyframe.
        seconds: since the last keyframe.
        interval: chosen at the last keyframe.
        config: limits.
    """
    distance, turn = float(np.hypot(moved.x(), moved.y())), abs(moved.theta())
    if turn >= (interval.turn or config.max_turn):
        return "turn"
    if config.unit == "scans":
        if scans >= interval.length:
            return "scans"
    elif distance >= interval.length:
        return "distance"
    if seconds >= config.max_time and max(distance, turn) > config.still:
        return "time"
    return ""
