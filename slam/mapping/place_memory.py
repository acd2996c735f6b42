"""Remembers what places look like, and says which of them the robot may be at again."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.pose_graph import PoseGraph
from slam.frontend.place_descriptor import PlaceConfig, PlaceIndex, describe, thinned
from slam.mapping.keyframe import Keyframe

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class RecognisedPlace:
    """A guess of where the newest keyframe is, made without regard to the graph's."""

    anchor: int  # index of the old keyframe that looks at the same things
    anchor_T_newest: Pose2


class PlaceMemory:
    """One descriptor for each metre of the way, made once the robot is past.

    Places are kept by the numbers of their keyframes: indices change where some are pruned.
    """

    def __init__(self, config: PlaceConfig, min_path_m: float) -> None:
        self._config, self._min_path_m = config, min_path_m
        self._index = PlaceIndex(config)
        self._numbers: list[int] = []  # of the keyframe at the centre of each place
        self._travelled: list[float] = []  # m, there

    def update(self, keyframes: Sequence[Keyframe], graph: PoseGraph) -> int:
        """Describe the places that the robot has left far enough behind; how many are new."""
        before = len(self._index)
        due = keyframes[-1].travelled_m - self._config.ahead
        first = bisect_left(keyframes, self._next_m, key=_travelled)
        for keyframe in keyframes[first:]:
            if keyframe.travelled_m > due:
                break
            if keyframe.travelled_m >= self._next_m:
                self._add(keyframe, keyframes, graph)
        return len(self._index) - before

    @property
    def _next_m(self) -> float:
        return self._travelled[-1] + self._config.every_m if self._travelled else 0.0

    def _add(self, centre: Keyframe, keyframes: Sequence[Keyframe], graph: PoseGraph) -> None:
        first, last = self._stretch(keyframes, centre.travelled_m)
        base = graph.pose(centre.index)
        poses = [base.between(graph.pose(k)) for k in range(first, last)]
        scans = [(poses[k], keyframes[first + k].prepared) for k in thinned(poses, self._config)]
        self._index.add(describe(scans, self._config))
        self._numbers.append(centre.number)
        self._travelled.append(centre.travelled_m)

    def _stretch(self, keyframes: Sequence[Keyframe], middle_m: float) -> tuple[int, int]:
        """First and one past the last keyframe of the submap about a place."""
        return (
            bisect_left(keyframes, middle_m - self._config.behind, key=_travelled),
            bisect_left(keyframes, middle_m + self._config.ahead, key=_travelled),
        )

    def recognise(
        self, keyframes: Sequence[Keyframe], graph: PoseGraph, count: int, apart: int
    ) -> list[RecognisedPlace]:
        """Old places that resemble the one described last, the likeliest first."""
        if not self._numbers:
            return []
        old_m = self._travelled[-1] - max(
            self._min_path_m, self._config.behind + self._config.ahead
        )
        old = bisect_left(self._travelled, old_m)
        query = self._index.descriptor(len(self._index) - 1)
        here = _by_number(keyframes, self._numbers[-1])
        newest = keyframes[-1]
        onward = graph.pose(here).between(graph.pose(newest.index))
        found = []
        for place, turn, _ in self._index.recognise(query, old, count, apart):
            centre = _by_number(keyframes, self._numbers[place])
            first, last = self._stretch(keyframes, self._travelled[place])
            centre_T_newest = Pose2(0.0, 0.0, turn) * onward
            seen = centre_T_newest.transformFrom(newest.centre)
            anchor = _looking_at(keyframes, graph, range(first, last), centre, seen)
            anchor_T_centre = graph.pose(anchor).between(graph.pose(centre))
            found.append(RecognisedPlace(anchor, anchor_T_centre * centre_T_newest))
        return found


def _looking_at(
    keyframes: Sequence[Keyframe], graph: PoseGraph, members: range, centre: int, seen: Matrix
) -> int:
    """The keyframe of a place that looks nearest to a point (2,) in the frame of its centre."""
    base = graph.pose(centre)
    away = []
    for k in members:
        looked_at = base.between(graph.pose(k)).transformFrom(keyframes[k].centre)
        away.append(float(np.hypot(*(looked_at - seen))))
    return members[int(np.argmin(away))]


def _by_number(keyframes: Sequence[Keyframe], number: int) -> int:
    """Index of a keyframe, or of the next one if it was pruned."""
    return min(bisect_left(keyframes, number, key=_number), len(keyframes) - 1)


def _number(keyframe: Keyframe) -> int:
    return keyframe.number


def _travelled(keyframe: Keyframe) -> float:
    return keyframe.travelled_m
