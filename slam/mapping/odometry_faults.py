"""The odometry fault detector: names a fault after the fact, from matches that are trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.chi_square import chi_square_limit, mahalanobis
from slam.frontend.match_types import MatchResult
from slam.mapping.odometry import OdometryConfig

OdometryFault = Literal["stall", "sign-flip", "slip", "jump", "distance"]

DOUBTFUL = chi_square_limit(0.1, 3)  # one consistent step in ten disagrees by more
LEVER = 0.5  # m per rad: weighs turns against ways when the size of a motion is judged


@dataclass(frozen=True, eq=False, slots=True)
class Step:
    """A step between keyframes as the odometry has it, and as a trusted match has it."""

    odometry: Pose2  # last_T_new
    matched: Pose2
    information: NDArray[np.float64]  # (3, 3) of the match, in the frame of the new keyframe
    distance: float  # m along the matched way
    turn: float  # rad along it, without sign
    seconds: float

    @classmethod
    def of(cls, odometry: Pose2, result: MatchResult, seconds: float) -> Step:
        """One step between neighbouring keyframes.

        How far sound odometry may be off follows from the true motion, not from what the
        odometry says: else a large fault would widen its own limits.
        """
        matched = result.target_T_source
        distance, turn = float(np.hypot(matched.x(), matched.y())), abs(matched.theta())
        return cls(odometry, matched, result.information, distance, turn, seconds)


class FaultDetector:
    """Compares odometry and matches, and names each fault once, when it is evident.

    A fault often lasts several keyframes, none of which refutes the odometry alone (a short step
    of the wrong sign is within its error).  So doubtful steps of one kind that follow each
    other are judged together, as one long step.
    """

    def __init__(self, config: OdometryConfig, false_alarm: float) -> None:
        self._config = config
        self._limit = chi_square_limit(false_alarm, 3)
        self._run: Step | None = None  # doubtful steps so far, joined
        self._kind: OdometryFault | None = None
        self._named = False
        self._other: tuple[OdometryFault, Step] | None = None  # steps of another kind after a name

    def watch(self, step: Step, refused: bool) -> OdometryFault | None:
        """The fault that this step makes evident; None if there is none, or it is already named.

        `refused` says that the odometry of this step was refused on its own.
        """
        if not refused and self._disagreement(step) <= DOUBTFUL:
            self.forget()
            return None
        kind = kind_of(step.odometry, step.matched)
        if self._named:
            return self._after_the_name(step, kind)
        if kind != self._kind:
            self.forget()
        self._run = step if self._run is None else _joined(self._run, step)
        self._kind = kind
        evident = refused or self._disagreement(self._run) > self._limit
        self._named = bool(evident)
        return kind if evident else None

    def _after_the_name(self, step: Step, kind: OdometryFault) -> OdometryFault | None:
        """Another name for the same run, if several of its steps in a row bear that one out.

        Where a fault begins or ends, half a step may look like another kind.
        """
        if kind == self._kind:
            self._other = None
        elif self._other is None or self._other[0] != kind:
            self._other = kind, step
        else:
            joined = _joined(self._other[1], step)
            self._other = kind, joined
            if self._disagreement(joined) > self._limit:
                self._kind, self._other = kind, None
                return kind
        return None

    def forget(self) -> None:
        """The run of doubtful steps has ended."""
        self._run, self._kind, self._named, self._other = None, None, False, None

    def _disagreement(self, step: Step) -> float:
        """Squared Mahalanobis distance of both motions, chi-square of 3 if both are right."""
        error = Pose2.Logmap(step.odometry.between(step.matched))
        covariance = self._config.covariance(step.distance, step.turn, step.seconds)
        return mahalanobis(error, covariance, step.information)


def kind_of(odometry: Pose2, matched: Pose2) -> OdometryFault:
    """The fault that would turn the true step `matched` into what the odometry says.

    "stall": hardly any motion where there was some; "sign-flip": the way mirrored; "slip": a wrong
    turn; "jump": far more way than there was; "distance": another wrong way.
    """
    claimed, true = _way(odometry), _way(matched)
    turn_claimed, turn_true = LEVER * abs(odometry.theta()), LEVER * abs(matched.theta())
    if np.hypot(*claimed) + turn_claimed < 0.5 * (np.hypot(*true) + turn_true):
        return "stall"
    if claimed @ true < 0.0 and np.hypot(*(claimed + true)) < 0.5 * np.hypot(*(claimed - true)):
        return "sign-flip"
    error = odometry.between(matched)
    if LEVER * abs(error.theta()) > np.hypot(error.x(), error.y()):
        return "slip"
    if np.hypot(*claimed) > 2.0 * np.hypot(*true):
        return "jump"
    return "distance"


def _way(step: Pose2) -> NDArray[np.float64]:
    return np.array([step.x(), step.y()])


def _joined(a: Step, b: Step) -> Step:
    """Two steps as one; the worse-known match bounds what is known of both."""
    weaker = min(a.information, b.information, key=lambda i: float(np.linalg.eigvalsh(i)[0]))
    return Step(
        a.odometry * b.odometry, a.matched * b.matched, 0.5 * weaker,
        a.distance + b.distance, a.turn + b.turn, a.seconds + b.seconds,
    )  # fmt: skip
