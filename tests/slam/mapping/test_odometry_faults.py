"""Lies of the odometry are told apart, and honest odometry is not accused."""

import numpy as np
import pytest
from gtsam import Pose2

from slam.mapping.odometry import OdometryConfig
from slam.mapping.odometry_faults import FaultDetector, Step, kind_of

AHEAD, BACK = Pose2(0.3, 0.0, 0.0), Pose2(-0.3, 0.01, 0.02)
SURE = np.diag([4e4, 4e4, 2.5e5])  # 5 mm, 2 mrad
FALSE_ALARM = 1e-4


def step(odometry, matched, information=SURE, seconds=0.5):
    distance, turn = np.hypot(matched.x(), matched.y()), abs(matched.theta())
    return Step(odometry, matched, information, distance, turn, seconds)


def detector():
    return FaultDetector(OdometryConfig(), FALSE_ALARM)


@pytest.mark.parametrize(
    ("kind", "odometry", "matched"),
    [
        ("stall", Pose2(), AHEAD),
        ("stall", Pose2(), Pose2(0.0, 0.0, 0.3)),
        ("sign-flip", BACK.inverse(), BACK),
        ("sign-flip", Pose2(0.3, 0.0, 0.02), BACK),
        ("slip", Pose2(0.3, 0.0, 0.35), AHEAD),
        ("slip", Pose2(0.0, 0.0, 0.35), Pose2(0.0, 0.0, -0.1)),
        ("jump", Pose2(1.2, 0.0, 0.0), AHEAD),
        ("jump", Pose2(0.3, 0.9, 0.0), AHEAD),
        ("jump", Pose2(-1.0, 0.0, 0.0), Pose2(0.02, 0.0, 0.0)),
        ("distance", Pose2(0.5, 0.0, 0.0), AHEAD),
    ],
)
def test_each_lie_has_its_name(kind, odometry, matched):
    assert kind_of(odometry, matched) == kind
    assert detector().watch(step(odometry, matched), refused=True) == kind


def test_a_lie_is_named_once_however_long_it_lasts():
    observer = detector()
    named = [observer.watch(step(Pose2(), AHEAD), refused=False) for _ in range(5)]
    assert named == ["stall", None, None, None, None]
    assert observer.watch(step(AHEAD, AHEAD), refused=False) is None
    assert observer.watch(step(Pose2(), AHEAD), refused=False) == "stall"


def test_short_steps_of_the_wrong_sign_are_evident_together():
    """One scan's step is within what a late odometry may be off; several in a row are not."""
    short = step(Pose2(0.05, 0.0, 0.0), Pose2(-0.05, 0.0, 0.0), seconds=0.1)
    observer = detector()
    named = [observer.watch(short, refused=False) for _ in range(6)]
    assert named[0] is None
    assert [name for name in named if name] == ["sign-flip"]


def test_a_lie_that_begins_with_half_a_step_gets_its_name_when_it_goes_on():
    """The first step goes half ahead and half back: the way told looks far too long."""
    observer, back = detector(), step(BACK.inverse(), BACK)
    assert observer.watch(step(AHEAD, Pose2(0.1, 0.0, 0.0)), refused=True) == "jump"
    assert [observer.watch(back, refused=True) for _ in range(4)] == [None, "sign-flip", None, None]


def test_half_a_step_at_the_end_of_a_lie_is_no_other_lie():
    observer, back = detector(), step(BACK.inverse(), BACK)
    assert observer.watch(back, refused=True) == "sign-flip"
    assert observer.watch(step(AHEAD, Pose2(0.1, 0.0, 0.0)), refused=True) is None
    assert observer.watch(step(AHEAD, AHEAD), refused=False) is None


def test_a_blind_match_accuses_nobody_along_its_blind_axis():
    blind = np.diag([0.0, 4e4, 2.5e5])
    observer = detector()
    assert observer.watch(step(Pose2(), AHEAD, blind), refused=False) is None


def test_honest_steps_are_seldom_accused():
    """Errors as the model has them, 10 000 steps: the false-alarm rate is kept."""
    config, rng = OdometryConfig(), np.random.default_rng(1)
    observer, named = detector(), 0
    root = np.sqrt(np.diag(config.covariance(0.3, 0.0, 0.5)))
    for _ in range(10_000):
        match_error = Pose2(*(rng.normal(size=3) * [0.005, 0.005, 0.002]))
        told = AHEAD * Pose2.Expmap(rng.normal(size=3) * root)
        named += observer.watch(step(told, AHEAD * match_error), refused=False) is not None
    assert named <= 10  # expected: 1 by single steps, some more by chance runs
