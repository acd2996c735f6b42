"""Independent pieces of surface that fit, are new, or contradict."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.frontend.agreement import agreement
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

AT = LaserExtrinsics(0, 0.0, 0.0, 0.0)
ANGLES = np.linspace(-np.pi, np.pi, 360, endpoint=False)


def seen_from(x, y, theta=0.0, person=None):
    """Scan of a room of 8 by 6 m about the origin; `person` is (bearing, range, half width)."""
    cos, sin = np.cos(ANGLES + theta), np.sin(ANGLES + theta)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(
            (np.where(cos > 0, 4.0, -4.0) - x) / cos, (np.where(sin > 0, 3.0, -3.0) - y) / sin
        )
    if person is not None:
        bearing, distance, half = person
        away = np.abs(np.remainder(ANGLES - bearing + np.pi, 2 * np.pi) - np.pi)
        ranges = np.where(away < half, distance, ranges)
    scan = LaserScan(0, -np.pi, 2 * np.pi / 360, ranges.astype(np.float32))
    return prepare(scan, AT, ScanConfig())


def judged(scan, at, reference=None):
    reference = reference or seen_from(0.0, 0.0)
    return agreement([Reference(Pose2(), reference)], scan, at, MatchConfig())


def test_at_the_right_pose_everything_fits():
    seen = judged(seen_from(0.3, 0.1, 0.2), Pose2(0.3, 0.1, 0.2))
    assert seen.share > 0.97
    assert seen.fitting > 25


@pytest.mark.parametrize("off", [Pose2(0.0, 0.0, 0.0), Pose2(0.3, 0.1, 0.4)])
def test_at_a_wrong_pose_much_contradicts(off):
    right = judged(seen_from(0.3, 0.1, 0.2), Pose2(0.3, 0.1, 0.2))
    wrong = judged(seen_from(0.3, 0.1, 0.2), off)
    assert wrong.log_likelihood < right.log_likelihood - 15.0


def test_a_person_is_one_piece_however_many_beams_it_fills():
    person = (2.0, 0.9, 0.22)
    scan = seen_from(0.5, 0.0, person=person)
    seen = judged(scan, Pose2(0.5, 0.0, 0.0), seen_from(0.0, 0.0, person=person))
    assert 0.5 < seen.contradicting < 2.0


def test_pieces_are_counted_once():
    seen = judged(seen_from(0.3, 0.1, 0.2), Pose2(0.3, 0.1, 0.2))
    assert seen.fitting + seen.new + seen.contradicting == pytest.approx(
        round(seen.fitting + seen.new + seen.contradicting)
    )
