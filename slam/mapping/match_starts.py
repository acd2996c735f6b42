"""Where a scan match may start when the odometry's step looks wrong."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gtsam import Pose2

from slam.frontend.correlative import CorrelativeConfig, Window, search, thin
from slam.frontend.loop_search import submap_points, target_field
from slam.frontend.match_types import Prior, Reference
from slam.frontend.scan import PreparedScan

LONGEST_STALL_S = 4.0  # s for which a robot may have gone on unseen; a wheel stall takes seconds
# The correlative search when all hypotheses fit badly: about the middle of the odometry's step.
SEARCH = CorrelativeConfig()
SEARCH_REFERENCES = 3  # last keyframes that it looks at
SEARCH_REACH_M = 1.0  # half width, beyond half of the step: a faulty step is off by its length
SEARCH_TURN_RAD = 0.8  # half width: more turn leaves little overlap at a view of 180 degrees
SEARCH_SCORE = 0.4  # least mean likelihood of a result; a wrong place scores 0.2 to 0.3


def starts_in_doubt(
    moved: Pose2, seconds: float, last_step: tuple[Pose2, float] | None
) -> list[tuple[str, Pose2]]:
    """Where else to start a match when the odometry's step `moved` looks wrong, by name.

    `last_step` is the motion to the last keyframe and how long (s) it took, if there was one.
    """
    starts = [
        ("zero motion", Pose2()),
        ("mirrored translation", Pose2(-moved.x(), -moved.y(), moved.theta())),
        ("turn only", Pose2(0.0, 0.0, moved.theta())),
        ("translation only", Pose2(moved.x(), moved.y(), 0.0)),
    ]
    if last_step is not None:
        step, duration = last_step
        share = min(seconds, LONGEST_STALL_S) / max(duration, 1e-3)
        starts.append(("previous velocity", Pose2.Expmap(share * Pose2.Logmap(step))))
    return starts


def searched_starts(
    references: Sequence[Reference], scan: PreparedScan, prior: Prior
) -> list[Pose2]:
    """Where a correlative search about the last keyframe and the odometry's step finds the scan."""
    last = references[-SEARCH_REFERENCES:]
    field = target_field([(r.target_T_scan, r.scan) for r in last], SEARCH)
    cloud = submap_points([(Pose2(), scan)])
    near = np.hypot(cloud[:, 0], cloud[:, 1]) < SEARCH.max_range
    points = thin(cloud[near], SEARCH.resolution, SEARCH.max_points)
    moved = prior.target_T_source
    reach = SEARCH_REACH_M + 0.5 * float(np.hypot(moved.x(), moved.y()))
    halfway = Pose2(0.5 * moved.x(), 0.5 * moved.y(), moved.theta())
    found = search(field, points, Window(halfway, reach, SEARCH_TURN_RAD), SEARCH_SCORE)
    return [] if found is None else [found.target_T_query]
