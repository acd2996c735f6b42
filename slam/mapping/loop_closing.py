"""Loop closure: which old keyframes to try, and what it takes for a closure to be believed."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from gtsam import Pose2
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.chi_square import chi_square_limit, mahalanobis
from slam.backend.pose_graph import Edge, PoseGraph
from slam.backend.pruning import Renumbered
from slam.backend.se2 import placed
from slam.frontend.loop_search import Closure, LoopSearchConfig
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import PreparedScan
from slam.logs.messages import LoopResult
from slam.mapping.keyframe import Keyframe, view_centres
from slam.mapping.loop_worker import LoopWorker, PlaceCandidate, Submit
from slam.mapping.records import pairs_left


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
    places_apart_m: float = Field(3.0, gt=0, description="m between two such places")
    query_keyframes: int = Field(4, ge=1, description="latest keyframes that form the query")
    target_half: int = Field(
        4, ge=0, description="keyframes either side of the anchor in the target"
    )
    narrow_prior_m: float = Field(0.8, gt=0, description="m, windows below need no second witness")
    supporting_closures: int = Field(
        2, ge=1, description="further closures that must agree with one from a wide window"
    )
    pending_m: float = Field(15.0, gt=0, description="m of travel a closure waits for witnesses")
    min_gain: float = Field(
        1.0, ge=0, description="a closure that tells the graph less (nats) waits for the end"
    )
    gate: float = Field(
        1e-3, gt=0, lt=1, description="chance of refusing a true closure by chi-square"
    )
    search: LoopSearchConfig = LoopSearchConfig()


@dataclass(frozen=True, eq=False, slots=True)
class LoopCandidate:
    """A closure that passed the search and waits to be believed."""

    edge: Edge
    closure: Closure
    stamp_ns: int
    travelled_m: float
    chi_square: float
    gain: float  # nats by which it would shrink what the graph does not know of its ends


class LoopCloser:
    """Finds, verifies and admits loop closures; the caller adds them to the graph.

    `begin` and `close` come in turn: the search may run beside whatever is done in between.
    """

    def __init__(self, config: LoopConfig, matcher: MatchConfig, submit: Submit) -> None:
        self.config = config
        self.closure_results: list[LoopResult] = []
        self._searcher = LoopWorker(config.search, matcher, submit)
        # Refused for the graph as it was then; the whole graph may side with them in the end.
        self.rejected: list[LoopCandidate] = []
        self._pending: list[LoopCandidate] = []
        self._searched_m = 0.0
        # Of each `target_half`-th keyframe: what it looks at, in its own frame, and the way to it.
        self._looks_at: list[tuple[float, float]] = []
        self._anchors_m: list[float] = []
        self._limit = chi_square_limit(config.gate, 3)

    def moved(self) -> None:
        """The graph changed its shape: forget maps of old places, which have moved within."""
        self._searcher.forget()

    def renumber(self, index: Renumbered) -> Counter[str]:
        """Keyframes have gone, and with them what was on record of them; counts of that."""
        self._searcher.forget()
        self._looks_at, self._anchors_m = [], []
        self.rejected = _left(self.rejected, index)
        waited = len(self._pending)
        self._pending = _left(self._pending, index)
        self.closure_results, gone = pairs_left(self.closure_results, index)
        counts = Counter(
            "accepted" if closure_result.accepted else "rejected" for closure_result in gone
        )
        counts["rejected"] += waited - len(self._pending)  # no verdict will come
        return counts

    @property
    def searching(self) -> bool:
        """Whether a search is at work just now."""
        return self._searcher.running

    def begin(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> bool:
        """Start a search for the newest keyframe; False if none is due."""
        newest = keyframes[-1]
        if not self.config.enabled or newest.travelled_m - self._searched_m < self.config.every_m:
            return False
        self._searched_m = newest.travelled_m
        places = self._places(keyframes, graph)
        ask = partial(self._place_candidates, keyframes, graph, places)
        self._searcher.begin(ask if places else None)
        return bool(places)

    def close(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> list[LoopCandidate]:
        """Closures that are now believed, from the search begun last and ones that waited.

        Keyframes and graph must be as they were when it was begun.
        """
        accepted: list[LoopCandidate] = []
        for place, closure in self._searcher.answers():
            candidate = self._judge(keyframes, graph, place, closure)
            if candidate is not None:
                accepted += self._admit(candidate, graph, keyframes[-1].travelled_m)
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
            if all(distance > self.config.places_apart_m for distance in apart):
                chosen.append(k)
            if len(chosen) == self.config.places:
                break
        return [k * stride for k in chosen]

    def _submap(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, members: Iterable[int], origin: int
    ) -> list[tuple[Pose2, PreparedScan]]:
        base = graph.pose(origin)
        return [(base.between(graph.pose(k)), keyframes[k].prepared) for k in members]

    def _place_candidates(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, anchors: Sequence[int]
    ) -> list[PlaceCandidate]:
        newest, half = keyframes[-1].index, self.config.target_half
        recent = range(max(0, newest - self.config.query_keyframes + 1), newest + 1)
        query = self._submap(keyframes, graph, recent, newest)
        places_to_try = []
        for anchor, known in zip(anchors, graph.relatives(anchors, newest), strict=True):
            near = range(max(0, anchor - half), min(newest, anchor + half + 1))
            middle = keyframes[anchor].number
            target = [k for k in near if abs(keyframes[k].number - middle) <= half]
            old = self._submap(keyframes, graph, target, anchor)
            places_to_try.append(PlaceCandidate(anchor, old, query, *known))
        return places_to_try

    def _judge(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, place: PlaceCandidate,
        closure: Closure,
    ) -> LoopCandidate | None:  # fmt: skip
        newest, anchor = keyframes[-1].index, place.anchor
        predicted, covariance = place.predicted, place.covariance
        stamp_ns = keyframes[-1].scan.stamp_ns
        result = closure.result
        if closure.reason or result is None:
            self._record(stamp_ns, anchor, newest, closure, closure.reason, np.nan)
            return None
        edge = Edge("loop", anchor, newest, result.target_T_source, result.information)
        error = Pose2.Logmap(predicted.between(result.target_T_source))
        # The match counts with what the graph will give it, not with its bare range noise.
        chi_square = mahalanobis(error, covariance, graph.weight(edge))
        travelled = keyframes[-1].travelled_m
        gain = 0.5 * float(np.linalg.slogdet(np.eye(3) + covariance @ graph.weight(edge))[1])
        candidate = LoopCandidate(edge, closure, stamp_ns, travelled, chi_square, gain)
        if chi_square > self._limit:
            self._conclude(candidate, f"chi-square {chi_square:.1f} against the graph")
            self.rejected.append(candidate)
            return None
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
        if 3 * sigma > self.config.narrow_prior_m:
            if result.degenerate_direction is None:
                return candidate
            self._conclude(candidate, "it does not tell where along the walls")
            return None
        self._record(stamp_ns, anchor, newest, closure, "accepted", chi_square)
        self._accepted_now = candidate
        return candidate

    _accepted_now: LoopCandidate | None = None

    def _admit(
        self, candidate: LoopCandidate, graph: PoseGraph, travelled_m: float
    ) -> list[LoopCandidate]:
        """The closures believed now: a tight one at once, a wide one with its witnesses."""
        if candidate is self._accepted_now:
            self._accepted_now = None
            return [candidate]
        kept = []
        for waiting in self._pending:
            if travelled_m - waiting.travelled_m > self.config.pending_m:
                self._conclude(waiting, "no further closure agreed with it")
            else:
                kept.append(waiting)
        self._pending = kept
        agreeing = [w for w in kept if self._consistent(w.edge, candidate.edge, graph)]
        if len(agreeing) < self.config.supporting_closures:
            self._pending.append(candidate)
            return []
        self._pending = [w for w in kept if not any(w is a for a in agreeing)]
        accepted_edges = [*agreeing, candidate]
        for one in accepted_edges:
            self._conclude(one, "accepted")
        return accepted_edges

    def _consistent(self, a: Edge, b: Edge, graph: PoseGraph) -> bool:
        """Pairwise consistency (Mangelson et al. 2018): do both closures tell the same story?"""
        if a.j == b.j:
            return False  # two answers to one question are no witnesses of each other
        new, new_cov = graph.relative(a.j, b.j)
        old, old_cov = (Pose2(), np.zeros((3, 3))) if a.i == b.i else graph.relative(a.i, b.i)
        # a.i -> a.j -> b.j against a.i -> b.i -> b.j
        around = (a.i_T_j * new).between(old * b.i_T_j)
        error = Pose2.Logmap(around)
        bridge = b.i_T_j.inverse().AdjointMap()
        back = new.inverse().AdjointMap()
        covariance = (
            new_cov
            + np.linalg.inv(graph.weight(b) + 1e-6 * np.eye(3))
            + back @ np.linalg.inv(graph.weight(a) + 1e-6 * np.eye(3)) @ back.T
            + bridge @ old_cov @ bridge.T
        )
        return float(error @ np.linalg.solve(covariance, error)) < self._limit

    def finish(self) -> None:
        """Give the closures that still wait their verdict."""
        for waiting in self._pending:
            self._conclude(waiting, "no further closure agreed with it")
        self._pending = []

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
