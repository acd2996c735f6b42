"""Loop closure: which old keyframes to try, and what it takes to accept a closure."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.chi_square import chi_square_limit, mahalanobis
from slam.backend.pose_graph import Edge, PoseGraph
from slam.backend.pruned_graph import Renumbered
from slam.backend.se2 import placed
from slam.frontend.loop_search import Closure, LoopSearchConfig
from slam.frontend.match_types import MatchConfig
from slam.frontend.place_descriptor import PlaceConfig
from slam.frontend.scan import PreparedScan
from slam.logs.messages import LoopResult
from slam.mapping.keyframe import Keyframe, view_centres
from slam.mapping.loop_worker import LoopWorker, PlaceCandidate, Submit
from slam.mapping.place_memory import PlaceMemory, RecognisedPlace
from slam.mapping.records import pairs_left

PLACES_APART_M = 3.0  # between places tried: one search covers a place of that size
# Places recognised by their shape, wherever the graph has them: so many are tried in a search,
# within 2 m and 0.25 rad (about two rings and two sectors) of the pose that the descriptor gives.
RECOGNISED = 3
RECOGNISED_COVARIANCE = np.diag([2.0**2, 2.0**2, 0.25**2]) / 9  # three sigma, m^2 and rad^2
RECOGNISED_AFTER_M = 5.0  # m of path after a closure without recognition: the graph knows better
MIN_GAIN = 1.0  # nats; a closure that adds less information waits for the final optimisation


class LoopConfig(BaseModel):
    """Loop closing."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    enabled: bool = Field(True, description="search for loops at all")
    every_m: float = Field(1.0, gt=0, description="m travelled between searches")
    min_path_m: float = Field(8.0, gt=0, description="m of path before a place counts as old")
    view_m: float = Field(
        4.0, gt=0, description="m between what two scans look at, if they overlap"
    )
    places: int = Field(3, ge=1, description="distinct places tried per search")
    query_keyframes: int = Field(4, ge=1, description="latest keyframes that form the query")
    target_half: int = Field(
        4, ge=0, description="keyframes either side of the anchor in the target"
    )
    narrow_prior_m: float = Field(
        0.8, gt=0, description="m, a prior narrower than this (3 sigma) needs no support"
    )
    supporting_closures: int = Field(
        2, ge=1, description="other closures that must agree with one from a wide prior"
    )
    pending_m: float = Field(15.0, gt=0, description="m of travel that a closure waits for support")
    gate: float = Field(
        1e-3, gt=0, lt=1, description="probability of refusing a true closure by its chi-square"
    )
    recognise: bool = Field(
        True, description="try places of similar shape too, wherever the graph has them"
    )
    search: LoopSearchConfig = LoopSearchConfig()


Status = Literal["accepted", "pending", "rejected"]
NO_SUPPORT = "no further closure agreed with it"


@dataclass(frozen=True, eq=False, slots=True)
class LoopCandidate:
    """A closure that passed the search."""

    edge: Edge
    closure: Closure
    stamp_ns: int
    travelled_m: float
    chi_square: float
    gain: float  # nats of information that it would add about the relative pose of its ends

    @property
    def refusal(self) -> str:
        """Why the graph refuses it."""
        return f"chi-square {self.chi_square:.1f} against the graph"


class LoopCloser:
    """Finds, verifies and accepts loop closures; the caller adds them to the graph.

    `begin` and `close` alternate: the search may run in the background in between.
    """

    def __init__(self, config: LoopConfig, matcher: MatchConfig, submit: Submit) -> None:
        self.config = config
        self.closure_results: list[LoopResult] = []
        self._worker = LoopWorker(config.search, matcher, submit)
        # Refused for the graph as it was then; the whole graph may agree with them in the end.
        self.rejected: list[LoopCandidate] = []
        self._pending: list[LoopCandidate] = []
        self._memory = PlaceMemory(PlaceConfig(), config.min_path_m)
        self._searched_m = 0.0
        self._closed_m = -math.inf  # path at which a closure was last accepted
        # Of each `target_half`-th keyframe: what it looks at, in its own frame, and the way to it.
        self._looks_at: list[tuple[float, float]] = []
        self._anchors_m: list[float] = []
        self._limit = chi_square_limit(config.gate, 3)

    def moved(self) -> None:
        """The graph changed its shape: forget the likelihood fields of old places."""
        self._worker.forget()

    def renumber(self, index: Renumbered) -> Counter[str]:
        """Keyframes have been pruned, and with them their records; returns counts of those."""
        self._worker.forget()
        self._looks_at, self._anchors_m = [], []
        self.rejected = _left(self.rejected, index)
        waited = len(self._pending)
        self._pending = _left(self._pending, index)
        self.closure_results, gone = pairs_left(self.closure_results, index)
        counts = Counter("accepted" if result.accepted else "rejected" for result in gone)
        counts["rejected"] += waited - len(self._pending)  # they will get no result
        return counts

    @property
    def searching(self) -> bool:
        """Whether a search is running now."""
        return self._worker.running

    def begin(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> bool:
        """Start a search for the newest keyframe; False if none is due."""
        newest = keyframes[-1]
        if not self.config.enabled or newest.travelled_m - self._searched_m < self.config.every_m:
            return False
        self._searched_m = newest.travelled_m
        places = self._places(keyframes, graph)
        recognised = self._recognised(keyframes, graph)
        ask = partial(self._place_candidates, keyframes, graph, places, recognised)
        due = bool(places or recognised)
        self._worker.begin(ask if due else None)
        return due

    def close(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> list[LoopCandidate]:
        """Closures that are now accepted, from the search begun last and ones that were pending.

        Keyframes and graph must be as they were when it was begun.
        """
        accepted: list[LoopCandidate] = []
        for place, closure in self._worker.answers():
            candidate = self._candidate(keyframes, graph, place, closure)
            if candidate is None:
                continue
            status = self._judge(candidate, place)
            if status == "accepted":
                accepted.append(candidate)
            elif status == "pending":
                accepted += self._with_support(candidate, graph, keyframes[-1].travelled_m)
        if accepted:
            self._closed_m = keyframes[-1].travelled_m
        return accepted

    def _places(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> list[int]:
        """Anchors of old places that the newest keyframe may be at, the likeliest first."""
        newest = keyframes[-1]
        stride = max(1, self.config.target_half)
        for keyframe in keyframes[len(self._anchors_m) * stride :: stride]:
            self._anchors_m.append(keyframe.travelled_m)
            self._looks_at.append((float(keyframe.centre[0]), float(keyframe.centre[1])))
        count = bisect_left(self._anchors_m, newest.travelled_m - self.config.min_path_m)
        if not count:
            return []
        poses = graph.poses[: count * stride : stride]
        centres = placed(np.array(self._looks_at[:count]), poses)
        here = view_centres([newest], graph.poses[newest.index :])[0]
        sigma = float(np.sqrt(np.linalg.eigvalsh(graph.marginal(newest.index)[:2, :2])[-1]))
        reach = min(3 * sigma, self.config.search.max_reach) + self.config.view_m
        away = np.hypot(*(centres - here).T)
        near = sorted(np.flatnonzero(away <= reach).tolist(), key=lambda k: (away[k], k))
        chosen: list[int] = []
        for k in near:
            apart = [np.hypot(*(centres[other] - centres[k])) for other in chosen]
            if all(distance > PLACES_APART_M for distance in apart):
                chosen.append(k)
            if len(chosen) == self.config.places:
                break
        return [k * stride for k in chosen]

    def _recognised(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> list[RecognisedPlace]:
        """Old places that look like the one the robot has just left, by their looks alone.

        None are tried where a closure was accepted a moment ago: the graph knows better then.
        """
        config = self.config
        if not config.recognise or not self._memory.update(keyframes, graph):
            return []
        if keyframes[-1].travelled_m - self._closed_m < RECOGNISED_AFTER_M:
            return []
        apart = round(PLACES_APART_M / PlaceConfig().every_m)
        return self._memory.recognise(keyframes, graph, RECOGNISED, apart)

    def _submap(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, members: Iterable[int], origin: int
    ) -> list[tuple[Pose2, PreparedScan]]:
        base = graph.pose(origin)
        return [(base.between(graph.pose(k)), keyframes[k].prepared) for k in members]

    def _place_candidates(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, anchors: Sequence[int],
        recognised: Sequence[RecognisedPlace],
    ) -> list[PlaceCandidate]:  # fmt: skip
        newest, half = keyframes[-1].index, self.config.target_half
        recent = range(max(0, newest - self.config.query_keyframes + 1), newest + 1)
        query = self._submap(keyframes, graph, recent, newest)
        known_of = graph.relatives(anchors, newest) if anchors else []
        tried = list(zip(anchors, known_of, strict=True))
        tried += [
            (place.anchor, (place.anchor_T_newest, RECOGNISED_COVARIANCE)) for place in recognised
        ]
        places_to_try = []
        for anchor, known in tried:
            near = range(max(0, anchor - half), min(newest, anchor + half + 1))
            middle = keyframes[anchor].number
            target = [k for k in near if abs(keyframes[k].number - middle) <= half]
            old = self._submap(keyframes, graph, target, anchor)
            places_to_try.append(PlaceCandidate(anchor, old, query, *known))
        return places_to_try

    def _candidate(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, place: PlaceCandidate,
        closure: Closure,
    ) -> LoopCandidate | None:  # fmt: skip
        """The closure as an edge, weighed against the graph; None if the search refused it."""
        newest, stamp_ns = keyframes[-1], keyframes[-1].scan.stamp_ns
        result = closure.result
        if closure.reason or result is None:
            self._record(stamp_ns, place.anchor, newest.index, closure, closure.reason, np.nan)
            return None
        edge = Edge("loop", place.anchor, newest.index, result.target_T_source, result.information)
        error = Pose2.Logmap(place.predicted.between(result.target_T_source))
        # The match counts with what the graph will give it, not with its bare range noise.
        information = graph.information(edge)
        chi_square = mahalanobis(error, place.covariance, information)
        gain = 0.5 * float(np.linalg.slogdet(np.eye(3) + place.covariance @ information)[1])
        return LoopCandidate(edge, closure, stamp_ns, newest.travelled_m, chi_square, gain)

    def _judge(self, candidate: LoopCandidate, place: PlaceCandidate) -> Status:
        """Accept what the graph expects, refuse what it contradicts; the rest needs support."""
        if candidate.chi_square > self._limit:
            self._conclude(candidate, candidate.refusal)
            self.rejected.append(candidate)
            return "rejected"
        sigma = float(np.sqrt(np.linalg.eigvalsh(place.covariance[:2, :2])[-1]))
        if 3 * sigma <= self.config.narrow_prior_m:
            self._conclude(candidate, "accepted")
            return "accepted"
        result = candidate.closure.result
        if result is None or result.degenerate_direction is not None:
            self._conclude(candidate, "the match does not fix the position along the walls")
            return "rejected"
        return "pending"

    def _with_support(
        self, candidate: LoopCandidate, graph: PoseGraph, travelled_m: float
    ) -> list[LoopCandidate]:
        """The closures that are accepted once enough of those that wait agree with this one."""
        waiting = []
        for other in self._pending:
            if travelled_m - other.travelled_m > self.config.pending_m:
                self._conclude(other, NO_SUPPORT)
            else:
                waiting.append(other)
        agreeing = [w for w in waiting if self._consistent(w.edge, candidate.edge, graph)]
        if len(agreeing) < self.config.supporting_closures:
            self._pending = [*waiting, candidate]
            return []
        self._pending = [w for w in waiting if not any(w is a for a in agreeing)]
        accepted = [*agreeing, candidate]
        for one in accepted:
            self._conclude(one, "accepted")
        return accepted

    def _consistent(self, a: Edge, b: Edge, graph: PoseGraph) -> bool:
        """Pairwise consistency (Mangelson et al. 2018): does the circle over both close?"""
        if a.j == b.j:
            return False  # two results of one search do not support each other
        new, new_cov = graph.relative(a.j, b.j)
        old, old_cov = (Pose2(), np.zeros((3, 3))) if a.i == b.i else graph.relative(a.i, b.i)
        # a.i -> a.j -> b.j against a.i -> b.i -> b.j
        around = (a.i_T_j * new).between(old * b.i_T_j)
        error = Pose2.Logmap(around)
        bridge = b.i_T_j.inverse().AdjointMap()
        back = new.inverse().AdjointMap()
        covariance = (
            new_cov
            + np.linalg.inv(graph.information(b) + 1e-6 * np.eye(3))
            + back @ np.linalg.inv(graph.information(a) + 1e-6 * np.eye(3)) @ back.T
            + bridge @ old_cov @ bridge.T
        )
        return float(error @ np.linalg.solve(covariance, error)) < self._limit

    def finish(self) -> None:
        """Refuse the closures that are still pending."""
        for waiting in self._pending:
            self._conclude(waiting, NO_SUPPORT)
        self._pending = []

    def judge(self, judged: Mapping[tuple[int, int], tuple[bool, str]]) -> None:
        """Replace results by those of the final optimisation: (used, why), by keyframes i and j."""
        self.closure_results = [
            replace(r, accepted=judged[r.i, r.j][0], reason=judged[r.i, r.j][1])
            if (r.i, r.j) in judged else r
            for r in self.closure_results
        ]  # fmt: skip

    def _conclude(self, candidate: LoopCandidate, reason: str) -> None:
        self._record(
            candidate.stamp_ns, candidate.edge.i, candidate.edge.j, candidate.closure, reason,
            candidate.chi_square,
        )  # fmt: skip

    def _record(
        self, stamp_ns: int, i: int, j: int, closure: Closure, reason: str, chi_square: float
    ) -> None:
        self.closure_results.append(
            LoopResult(
                stamp_ns,
                i,
                j,
                reason == "accepted",
                reason,
                closure.score,
                closure.second_score,
                chi_square,
            )
        )


def _left(candidates: Sequence[LoopCandidate], index: Renumbered) -> list[LoopCandidate]:
    """Those between keyframes that stay, under their new indices."""
    return [
        replace(c, edge=index.renamed(c.edge))
        for c in candidates
        if index.keeps(c.edge.i, c.edge.j)
    ]
