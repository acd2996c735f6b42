"""A lie of the wheels within a stretch that is halved, and where a robot may have gone on to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from gtsam import Pose2
from slam.logs.messages import LaserScan

from slam.mapping.config import SlamConfig
from slam.mapping.keyframe_edges import KeyframeEdgeBuilder
from slam.mapping.match_starts import starts_in_doubt
from slam.mapping.registration import Registration
from slam.mapping.scan_sync import ZERO_BIAS, OdometryIncrement, next_stamped_scan


def increment(moved, seconds, bias=ZERO_BIAS):
    scans = [LaserScan(round(s * 1e9), 0.0, 0.1, np.ones(4, np.float32)) for s in (0.0, seconds)]
    first = next_stamped_scan(scans[0], Pose2(), 0, None)
    return OdometryIncrement(first, next_stamped_scan(scans[1], moved, 1, first), bias)


def registration(
    found,
    inlier_fraction=0.9,
    odometry_trusted=False,
    match_trusted=True,
    degenerate_direction=None,
):
    known = np.diag([4e4, 4e4, 2.5e5])
    result = SimpleNamespace(
        target_T_source=found,
        inlier_fraction=inlier_fraction,
        information=known,
        degenerate_direction=degenerate_direction,
    )
    return Registration(result, odometry_trusted, match_trusted, "")


def test_a_refuted_stretch_makes_its_parts_suspect_by_the_size_of_the_lie():
    builder = KeyframeEdgeBuilder(SlamConfig())
    way, turn = builder.suspected_bias(
        increment(Pose2(0.2, 0, 0), 2.0), registration(Pose2(1.4, 0, 0.1))
    )
    assert (way, turn) == (pytest.approx(0.6), pytest.approx(0.05))
    later = builder.suspected_bias(
        increment(Pose2(0.1, 0, 0), 1.0, (0.9, 0.0)), registration(Pose2(0.7, 0, 0))
    )
    assert later == (0.9, 0.0)  # what is known of the whole stays known of its parts


@pytest.mark.parametrize(
    "seen",
    [
        registration(Pose2(1.4, 0, 0), match_trusted=False),
        registration(Pose2(1.4, 0, 0), odometry_trusted=True),
    ],
)
def test_only_a_match_that_refutes_the_wheels_makes_them_suspect(seen):
    assert (
        KeyframeEdgeBuilder(SlamConfig()).suspected_bias(increment(Pose2(0.2, 0, 0), 2.0), seen)
        == ZERO_BIAS
    )


@pytest.mark.parametrize(
    ("match_trusted", "degenerate_direction", "used"),
    [(True, None, [False, True]), (True, 0.0, [True, True]), (False, None, [True, False])],
)
def test_a_part_of_a_refuted_stretch_keeps_its_odometry_if_nothing_else_holds_it(
    match_trusted, degenerate_direction, used
):
    """Without any edge the keyframe would be loose, and the run would end."""
    here = increment(Pose2(0.1, 0, 0), 0.5, (0.6, 0.0))
    seen = registration(
        Pose2(0.3, 0, 0),
        0.9,
        True,
        match_trusted=match_trusted,
        degenerate_direction=degenerate_direction,
    )
    found = KeyframeEdgeBuilder(SlamConfig()).edges(here, seen, 1)
    assert [is_used for _, is_used in found.edges] == used
    assert ("odometry refused" in found.note) == (not used[0])


def test_wheels_that_stood_still_for_seconds_may_have_hidden_the_whole_way():
    """A corridor's keyframes come every 0.4 s: the way of six of them is where to look."""
    starts = dict(starts_in_doubt(Pose2(0.25, 0.0, 0.0), 2.4, (Pose2(0.24, 0.0, 0.0), 0.4)))
    assert starts["previous velocity"].x() == pytest.approx(1.44)
    ages = dict(starts_in_doubt(Pose2(), 60.0, (Pose2(0.24, 0.0, 0.0), 0.4)))
    assert ages["previous velocity"].x() == pytest.approx(2.4)
