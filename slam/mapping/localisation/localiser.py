"""Localisation in a finished map: one step function for the robot and for the replay.

No file, device, clock, thread or print in here: equal messages give equal poses, bit for bit.
Memory and time per scan are bounded, whatever the length of the drive: the map stays as it is, and
of the drive only the present is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.frontend.match_types import Prior
from slam.frontend.scan import PreparedScan
from slam.logs.messages import Message
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import preparer
from slam.mapping.keyframe_edges import USUAL_SPEED, USUAL_TURN_RATE
from slam.mapping.localisation.evidence import near_enough, tracked_right
from slam.mapping.localisation.fixed_map import FixedMap
from slam.mapping.localisation.global_search import GlobalSearch, different
from slam.mapping.localisation.hypothesis import (
    MAP_ERROR,
    Hypothesis,
    Motion,
    bounded,
    follow,
)
from slam.mapping.localisation.innovation import InnovationCheck
from slam.mapping.localisation.scan_feed import ScanFeed
from slam.mapping.match_starts import starts_in_doubt
from slam.mapping.registration import NEVER, OdometryEvidence, register
from slam.mapping.relocalise import PriorMap
from slam.mapping.scan_sync import STAMP_JITTER_S, OdometryIncrement, StampedScan

Matrix = NDArray[np.float64]

FOUND_BELOW = 0.05  # probability of a wrong pose, below which a robot that was lost is found
LOST_ABOVE = 0.5  # probability of a wrong pose, above which it is lost
STEP_M, STEP_RAD = 0.2, 0.2  # way and turn between two looks at several hypotheses
SEARCH_M, SEARCH_RAD = 1.0, 1.0  # way and turn between two searches of the whole map
MOST_HYPOTHESES = 32
ELSEWHERE_BELOW = 0.02  # probability of a robot elsewhere, below which no more is searched for
HOPELESS_NATS = 12.0  # below the best one, or a robot elsewhere: given up
FAULT_RATE = 1e-3  # probability of an odometry fault in a step


@dataclass(frozen=True, eq=False, slots=True)
class Localised:
    """Where the robot is thought to be at a scan."""

    stamp_ns: int
    odom_T_base: Pose2
    map_T_base: Pose2 | None  # the likeliest one; None where there is none at all
    covariance: Matrix  # (3, 3) in the frame of the base, if the pose is right
    wrong: float  # probability that the pose is off by more than 0.5 m or 10 degrees
    lost: bool  # it is not to be used
    hypotheses: int  # places where the robot may be
    rivals: int  # of these, places that are about as likely as the likeliest one


class Localiser:
    """Messages in, poses in a finished map out."""

    def __init__(self, config: SlamConfig, prior_map: PriorMap) -> None:
        self.config = config
        self._prepare = preparer(config.scan)
        self.feed = ScanFeed(config, self._prepare)
        self.feed.extrinsics = prior_map.extrinsics
        self._map = FixedMap(prior_map.keyframes, prior_map.poses)
        self._search = GlobalSearch(self._map, config.localise.neighbours, config.matcher)
        self._start = prior_map.start
        self._hypotheses: list[Hypothesis] = []
        self._found = self._just_lost = False
        self._last: StampedScan | None = None
        self._unused: Motion | None = None  # since several hypotheses were last looked at
        self._searched: tuple[float, float] | None = None  # path (m, rad) at the last search
        self._check = InnovationCheck(config.odometry)
        self._innovation = 0.0  # nats, as the check gives them
        self.searches = 0
        self.times_lost = 0

    def step(self, message: Message) -> Iterator[Localised]:
        """Take in one message, in the order of the log; yield the scans that are placed now."""
        for stamped in self.feed.take(message):
            yield self._placed(stamped)

    def finish(self) -> Iterator[Localised]:
        """No more messages will come: yield what still waits."""
        for stamped in self.feed.finish():
            yield self._placed(stamped)

    def _placed(self, stamped: StampedScan) -> Localised:
        scan = self._prepare(stamped.scan, self.feed.extrinsics)
        motion = self._motion(stamped)
        self._last = stamped
        usable = scan.valid >= self.config.matcher.min_pairs
        if motion is not None:
            self._hypotheses = [h.predicted(motion) for h in self._hypotheses]
            self._unused = self._unused.then(motion) if self._unused else motion
        if usable and self._found:
            self._track(scan, motion)
            self._innovation = self._check.nats(stamped, self._hypotheses[0].pose)
        elif usable:
            self._look(scan, stamped)
        return self._judged(stamped)

    def _motion(self, stamped: StampedScan) -> Motion | None:
        if self._last is None:
            return None
        step = OdometryIncrement(self._last, stamped)
        covariance = self.config.odometry.covariance(step.path_m, step.path_rad, step.seconds)
        unknown = np.array([USUAL_SPEED, USUAL_SPEED, USUAL_TURN_RATE]) * step.unknown_s
        return Motion(step.moved, covariance + np.diag(unknown**2), step.seconds)

    def _track(self, scan: PreparedScan, motion: Motion | None) -> None:
        """Follow the one place where the robot is."""
        assert motion is not None
        here = self._hypotheses[0]
        base, references = self._map.near(scan, here.pose, self.config.localise.neighbours)
        guess = base.between(here.pose)
        before = guess * motion.moved.inverse()
        seconds = motion.seconds + STAMP_JITTER_S
        metres, radians = self.config.robot.reach(seconds)
        away = math.hypot(guess.x(), guess.y())
        starts = [(name, before * s) for name, s in starts_in_doubt(motion.moved, seconds, None)]
        evidence = OdometryEvidence(
            Prior(guess, here.covariance + MAP_ERROR), starts, True,
            (metres + away, min(math.pi, radians + abs(guess.theta()))), FAULT_RATE,
            NEVER,  # a robot that was carried is found by `lost`
        )  # fmt: skip
        config = self.config
        found = register(references, scan, evidence, config.registration, config.matcher)
        if found.match_trusted:
            here = here.at(base, found.result)
        seen = self._map.seen(scan, here.pose, config.matcher)
        self._hypotheses = bounded([here.weighed(seen, motion)])
        self._unused = None

    def _look(self, scan: PreparedScan, stamped: StampedScan) -> None:
        """Compare the places where the robot may be, and look for more of them."""
        motion = self._unused
        if motion is not None and self._hypotheses and self._is_due(motion):
            self._compare(scan, motion)
            self._unused = None
        if self._start is not None:
            self._hypotheses = self._search(scan, self._start)
            self._start, self._searched = None, None
            if self._hypotheses:
                self._searched = stamped.path_m, stamped.path_rad
                return
        if self._search_due(stamped):
            self.searches += 1
            self._searched = stamped.path_m, stamped.path_rad
            if self._just_lost:
                more = self._search.nearby(scan, self._hypotheses[0].pose)
            else:
                more = self._search(scan)
            self._just_lost = False
            self._hypotheses = self._best(different([*self._hypotheses, *more]))

    def _is_due(self, motion: Motion) -> bool:
        way = math.hypot(motion.moved.x(), motion.moved.y()) / STEP_M
        return way + abs(motion.moved.theta()) / STEP_RAD >= 1.0 or len(self._hypotheses) == 1

    def _search_due(self, stamped: StampedScan) -> bool:
        """Whether the robot has moved since the last search, and may be at none of the places."""
        if self._searched is None:
            return True
        if self._elsewhere < ELSEWHERE_BELOW:
            return False
        way, turn = stamped.path_m - self._searched[0], stamped.path_rad - self._searched[1]
        return way / SEARCH_M + turn / SEARCH_RAD >= 1.0

    @property
    def _elsewhere(self) -> float:
        """Probability that no hypothesis is right."""
        return 1.0 / (1.0 + sum(math.exp(h.log_odds) for h in self._hypotheses))

    def _compare(self, scan: PreparedScan, motion: Motion) -> None:
        config, followed = self.config, []
        for hypothesis in self._hypotheses:
            at, seen = follow(
                hypothesis, scan, self._map, config.localise.neighbours, config.matcher
            )
            followed.append(at.weighed(seen, motion))
        followed.sort(key=lambda h: -h.log_odds)
        self._hypotheses = self._best(different(followed))

    def _best(self, hypotheses: list[Hypothesis]) -> list[Hypothesis]:
        """Those with a chance."""
        ranked = sorted(hypotheses, key=lambda h: -h.log_odds)
        if not ranked:
            return []
        least = ranked[0].log_odds - HOPELESS_NATS
        return bounded([h for h in ranked if h.log_odds > least][:MOST_HYPOTHESES])

    def _judged(self, stamped: StampedScan) -> Localised:
        """What is known now; found and lost have a gap between them, so that none flickers."""
        stamp_ns, odom_T_base = stamped.scan.stamp_ns, stamped.odom_T_base
        if not self._hypotheses:
            return Localised(stamp_ns, odom_T_base, None, np.eye(3), 1.0, True, 0, 0)
        best = self._hypotheses[0]
        log_odds = np.array([0.0, *(h.log_odds for h in self._hypotheses)])
        weights = np.exp(log_odds - log_odds.max())
        share = float(weights[1] / weights.sum())
        evidence = best.mean_evidence + self._innovation
        right = share * tracked_right(evidence) * near_enough(best.covariance)
        wrong = 1.0 - right
        if self._found and wrong > LOST_ABOVE:
            self._lose()
        elif not self._found and wrong < FOUND_BELOW:
            self._found = True
            self._check.forget()
            self._hypotheses = [best]
        rivals = int(np.sum(log_odds[2:] > best.log_odds - math.log(10.0)))
        return Localised(
            stamp_ns, odom_T_base, best.pose, best.covariance, wrong, not self._found,
            len(self._hypotheses), rivals,
        )  # fmt: skip

    def _lose(self) -> None:
        """Nothing is sure any more: the place may still be right, or any other."""
        self._found, self._just_lost = False, True
        self.times_lost += 1
        self._searched, self._innovation = None, 0.0
        self._hypotheses = [replace(h, log_odds=min(h.log_odds, 0.0)) for h in self._hypotheses]
