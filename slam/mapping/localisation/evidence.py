"""What a scan says for a pose in a finished map, and the probability that the pose is wrong.

A scan is taken apart into pieces of surface (`agreement`): each fits the map at a pose, contradicts
it, or is new.  At a right pose few contradict, moved furniture and people; at a wrong one, and be
it the best-matching one, more do.  The log ratio of how likely the pieces are in both cases is the
evidence for the pose.

The figures come from simulated buildings (`slam bench evidence`), never from a recorded log.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slam.frontend.agreement import Agreement

Matrix = NDArray[np.float64]

WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)  # a pose that errs by more is wrong

# Log of how likely what a scan shows is at a right pose over how likely it is at a wrong one that a
# search has found: from 3800 poses in five kinds of simulated buildings, half of them seen again
# with 30 % of the furniture moved.  At right poses 5 % of the pieces contradict (22 % in a hall of
# nothing but crates), at wrong ones 28 %.  A regression over all gives -2.2, 0.32 and -0.78, which
# is too hard on changed halls; these figures leave 19 of 20 right poses above 0 in all others, and
# half of the wrong ones below -1.5.
SCAN_NATS = -2.2  # a search or a match has made the best of the pose before it is looked at
FITTING_NATS = 0.3  # of a piece
CONTRADICTING_NATS = -0.5
NEW_NATS = -0.1  # less than it was in simulation: real maps have gaps
MOST_NATS = 8.0  # of a scan, either way

# Log odds of a tracked pose that nothing speaks for or against: one scan in fifty of a drive on
# which the robot is carried away now and then.
TRACKED_LOG_ODDS = 4.0


def scan_evidence(seen: Agreement) -> float:
    """Nats for a pose by what one scan shows there, at most MOST_NATS either way."""
    fitting, contradicting = FITTING_NATS * seen.fitting, CONTRADICTING_NATS * seen.contradicting
    nats = SCAN_NATS + fitting + contradicting + NEW_NATS * seen.new
    return max(-MOST_NATS, min(MOST_NATS, nats))


def sigmoid(log_odds: float) -> float:
    """Probability of log odds, however large."""
    return 0.5 * (1.0 + math.tanh(0.5 * log_odds))


def tracked_right(mean_evidence: float) -> float:
    """Probability that a tracked pose is right, by the mean evidence of the last scans (nats)."""
    return sigmoid(TRACKED_LOG_ODDS + mean_evidence)


def near_enough(covariance: Matrix) -> float:
    """Probability that an error of this covariance (3, 3) is no larger than a right pose's."""
    across = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]), 1e-12))
    turn = math.sqrt(max(float(covariance[2, 2]), 1e-12))
    return math.erf(WRONG_M / across / math.sqrt(2)) * math.erf(WRONG_RAD / turn / math.sqrt(2))
