"""Removes redundant keyframes: where a robot has passed often enough, more of them add nothing.

Without it a graph grows with time, with it only with the area covered (cf. Johannsson et
al. 2013, "Temporally scalable visual SLAM using a reduced pose graph").
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterable, Sequence
from concurrent.futures import Future

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.backend.edges import Edge
from slam.backend.pose_graph import PoseGraph
from slam.backend.pruned_graph import Pruned, Renumbered
from slam.backend.se2 import compose, placed
from slam.mapping.keyframe import Keyframe
from slam.mapping.loop_worker import Submit

Matrix = NDArray[np.float64]

# A new graph is made when this many keyframes can go, and this share of all: it costs a tenth of a
# second at 600 keyframes, and grows with the graph.
PRUNED_AT_ONCE, PRUNED_SHARE = 64, 0.1


class PruningConfig(BaseModel):
    """Removing keyframes from the graph where others have the same view."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    min_redundancy: int = Field(
        8, ge=0, description="older keyframes with the same view that make one redundant; "
        "0 keeps all"
    )  # fmt: skip
    within_m: float = Field(
        0.5, gt=0, description="m between two views that count as the same, of the robot and "
        "what it looks at together"
    )  # fmt: skip


class FormerPlaces:
    """Where pruned keyframes were, for the scans around them: 40 bytes each."""

    def __init__(self) -> None:
        self._scans, self._anchors = array("q"), array("q")
        self._poses = array("d")

    def add(self, scan_index: int, anchor: int, anchor_T_it: Pose2) -> None:
        """Remember the scan of one, and its place with respect to a keyframe that stays."""
        self._scans.append(scan_index)
        self._anchors.append(anchor)
        self._poses.extend((anchor_T_it.x(), anchor_T_it.y(), anchor_T_it.theta()))

    def renumber(self, index: Renumbered) -> None:
        """Follow the anchors."""
        self._anchors = array("q", index.all(np.array(self._anchors, np.int64)).tolist())

    def joined(
        self, keyframes: Sequence[Keyframe], poses: Matrix
    ) -> tuple[NDArray[np.int64], Matrix, NDArray[np.int64]]:
        """All places, of keyframes and former ones, in the order of their scans.

        Args:
            keyframes: of the graph.
            poses: (n, 3) map_T_base of them.

        Returns:
            (m,) scans, (m, 3) map_T_base there, (m,) keyframes with respect to which these hold.
        """
        anchors = np.array(self._anchors, np.int64)
        scans = np.array([*(k.scan_index for k in keyframes), *self._scans], np.int64)
        former = compose(poses[anchors], np.array(self._poses).reshape(-1, 3))
        order = np.argsort(scans, kind="stable")
        owners = np.concatenate([np.arange(len(poses)), anchors])
        return scans[order], np.concatenate([poses, former])[order], owners[order]


class Pruner:
    """Judges each keyframe once, when it is old enough for loops, and removes many at once.

    The smaller graph is made in the background, as loop searches are.
    """

    def __init__(self, config: PruningConfig, old_m: float, submit: Submit) -> None:
        self.places = FormerPlaces()
        self._config, self._old_m, self._submit = config, old_m, submit
        self._making: Future[tuple[PoseGraph, Pruned]] | None = None
        self._judged = 1  # keyframes, so far; the graph hangs on the first
        self._centres = array("d")
        self._redundant: list[int] = []
        # Of keyframes not judged yet, also those that were refused for the graph as it was.
        self._closures: dict[int, list[Edge]] = {}
        self._agrees = False  # whether the graph agrees with the last closures passed

    def add_closures(self, edges: Iterable[Edge]) -> None:
        """Take note of closures, whether accepted or refused by the graph."""
        for edge in edges:
            if edge.j >= self._judged:
                self._closures.setdefault(edge.j, []).append(edge)

    def begin_at(self, keyframe: int) -> None:
        """Keep all before this one."""
        self._judged = keyframe

    def due(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, odometry_faulty: Collection[int]
    ) -> bool:
        """Judge those that have become old; whether enough are redundant by now.

        `odometry_faulty` are scans to which the odometry did not lead: their keyframes are kept.
        """
        if not self._config.min_redundancy:
            return False
        now_m = keyframes[-1].travelled_m
        while (k := self._judged) < len(keyframes):
            if now_m - keyframes[k].travelled_m <= self._old_m:
                break
            if edges := self._closures.pop(k, None):
                self._agrees = all(graph.agrees(edge) for edge in edges)
            if (
                self._agrees and keyframes[k].scan_index not in odometry_faulty
                and self._is_redundant(keyframes, graph, k) and self._agrees_ahead(graph)
            ):  # fmt: skip
                self._redundant.append(k)
            self._judged += 1
        return len(self._redundant) >= max(PRUNED_AT_ONCE, PRUNED_SHARE * len(keyframes))

    def begin(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, odometry_faulty: Collection[int]
    ) -> bool:
        """Begin to make a smaller graph; False if it is not `due`.  None may change until taken."""
        if not self.due(keyframes, graph, odometry_faulty):
            return False
        self._making = self._submit(graph.without, self._redundant)
        return True

    def take(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph
    ) -> tuple[PoseGraph, Pruned] | None:
        """The graph without the redundant ones, and what became of its edges; None: not begun."""
        if self._making is None:
            return None
        smaller, left = self._making.result()
        self._making = None
        for k, anchor in left.anchors.items():
            there = graph.pose(anchor).between(graph.pose(k))
            self.places.add(keyframes[k].scan_index, anchor, there)
        self.places.renumber(left.index)
        self._judged -= len(self._redundant)
        known, self._closures = self._closures, {}
        self.add_closures(
            left.index.renamed(edge)
            for edges in known.values()
            for edge in edges
            if left.index.keeps(edge.i, edge.j)
        )
        self._centres, self._redundant = array("d"), []
        return smaller, left

    def _agrees_ahead(self, graph: PoseGraph) -> bool:
        """Whether the graph agrees with the next closures, too: then nothing is wrong between."""
        if not self._closures:
            return False
        return all(graph.agrees(edge) for edge in self._closures[min(self._closures)])

    def _is_redundant(self, keyframes: Sequence[Keyframe], graph: PoseGraph, k: int) -> bool:
        """Whether enough others have the same view, and the graph is certain of that (3 sigma)."""
        poses, within = graph.poses[: k + 1], self._config.within_m
        near = np.flatnonzero(np.abs(poses[:, 0] - poses[k, 0]) <= within)
        near = near[np.abs(poses[near, 1] - poses[k, 1]) <= within]
        if len(near) <= self._config.min_redundancy:  # the last is the one in question
            return False
        near = near[~np.isin(near, self._redundant)]
        for keyframe in keyframes[len(self._centres) // 2 : k + 1]:
            self._centres.extend(keyframe.centre)
        centres = np.frombuffer(self._centres).reshape(-1, 2)[near]
        views = np.hstack([placed(centres, poses[near]), poses[near, :2]])
        away = np.sqrt(np.sum((views[:-1] - views[-1]) ** 2, axis=1))
        if np.count_nonzero(away <= within) < self._config.min_redundancy:
            return False
        covariance = graph.relative(int(near[np.argmin(away)]), k)[1]
        sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
        return 3.0 * sigma <= within
