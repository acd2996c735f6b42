"""A finished map as the localiser sees it: keyframes that stay where they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.se2 import placed
from slam.frontend.agreement import Agreement, agreement
from slam.frontend.batch_matching import view_of_each
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.scan import VALID, PreparedScan
from slam.mapping.keyframe import Keyframe, view_centres

Matrix = NDArray[np.float64]

# Keyframes by which a pose is judged: more than a match takes, for what the nearest few did not
# look at is not new for the map.
JUDGES = 25


class FixedMap:
    """Keyframes with their poses, found by what they look at."""

    def __init__(self, keyframes: Sequence[Keyframe], poses: Matrix) -> None:
        """Take keyframes at `poses` (n, 3), map_T_base."""
        from scipy.spatial import cKDTree  # takes a quarter of a second to import

        self.keyframes, self.at = keyframes, np.ascontiguousarray(poses)
        self._poses = [Pose2(*pose) for pose in poses]
        self._views: Any = cKDTree(np.hstack([view_centres(keyframes, poses), poses[:, :2]]))

    def near(
        self, scan: PreparedScan, map_T_base: Pose2, count: int
    ) -> tuple[Pose2, list[Reference]]:
        """The keyframes whose view is the most like the scan's, the most similar one last.

        They are given in the frame of that one, whose pose comes first: map_T_frame.
        """
        at = np.array([[map_T_base.x(), map_T_base.y(), map_T_base.theta()]])
        count = min(count, len(self._poses))
        rows = np.atleast_1d(self._views.query(view_of_each([scan], at)[0], k=count)[1]).tolist()
        base = self._poses[rows[0]]
        return base, [
            Reference(base.between(self._poses[k]), self.keyframes[k].prepared)
            for k in reversed(rows)
        ]

    def seen(self, scan: PreparedScan, map_T_base: Pose2, matcher: MatchConfig) -> Agreement:
        """What the map says of a scan at a pose."""
        base, references = self.near(scan, map_T_base, JUDGES)
        return agreement(references, scan, base.between(map_T_base), matcher)

    def points(self, max_range: float) -> Matrix:
        """All that the keyframes see within `max_range` m, (n, 2) m in the map frame."""
        parts = []
        for keyframe, pose in zip(self.keyframes, self.at, strict=True):
            scan = keyframe.prepared
            seen = ((scan.flags & VALID) > 0) & (scan.ranges < max_range)
            points = scan.points[seen]
            parts.append(placed(points, np.broadcast_to(pose, (len(points), 3))))
        return np.concatenate(parts)
