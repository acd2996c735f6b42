import math
from itertools import pairwise

import pytest
from slam.drivers.motion import MotionConfig, MotionGuard

SECOND = 1_000_000_000


def run(guard, seconds, ask=None, start=0):
    out = []
    for k in range(round(seconds * 50)):
        now = start + k * SECOND // 50
        if ask is not None:
            guard.request(*ask, now)
        if (command := guard.due(now)) is not None:
            out.append(command)
    return out


def test_nothing_is_due_until_somebody_asks():
    assert run(MotionGuard(MotionConfig()), 2.0) == []


def test_speed_is_ramped_and_limited():
    speeds = [v for v, _ in run(MotionGuard(MotionConfig()), 3.0, (9.0, 0.0))]
    assert max(speeds) == 400
    assert all(0 <= b - a <= 31 for a, b in pairwise(speeds))


def test_turning_is_limited_both_ways():
    turns = [w for _, w in run(MotionGuard(MotionConfig()), 3.0, (0.0, -9.0))]
    assert min(turns) == round(math.degrees(-0.6))


def test_a_dead_mans_hand_stops_the_robot_and_then_the_commands():
    guard = MotionGuard(MotionConfig())
    run(guard, 2.0, (0.4, 0.0))
    after = run(guard, 4.0, start=2 * SECOND)
    assert after[-1] == (0, 0)
    assert len(after) < 25  # 0.5 s of grace, 1.4 s of ramp
    assert run(guard, 1.0, start=6 * SECOND) == []


def test_a_gap_in_time_is_no_licence_for_a_leap():
    guard = MotionGuard(MotionConfig())
    guard.request(0.4, 0.0, 0)
    guard.due(0)
    guard.request(0.4, 0.0, 10 * SECOND)
    assert guard.due(10 * SECOND)[0] <= 90


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (0.0, math.inf)])
def test_numbers_that_are_none_are_refused(bad):
    with pytest.raises(ValueError, match="cannot drive"):
        MotionGuard(MotionConfig()).request(*bad, 0)


@pytest.mark.parametrize("wrong", [{"speed_max": 0.0}, {"dead_man_s": 3.0}, {"period_s": 1.0}])
def test_limits_that_are_none_are_refused(wrong):
    with pytest.raises(ValueError, match=r"positive|need"):
        MotionConfig(**wrong)
