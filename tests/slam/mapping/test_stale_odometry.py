"""Odometry that is older than its stamp, among all that a robot may really do."""

import math

import pytest
from slam.logs.messages import WheelOdometry

from slam.mapping.stale_odometry import StaleOdometryFilter

STEP_S = 0.1


def drive(count=80, speed=0.5, turning=0.3, back_at=None):
    """Readings of a drive along an arc; from `back_at` on, the robot goes the same way back."""
    x = y = theta = 0.0
    readings = []
    for k in range(count):
        readings.append(WheelOdometry(round(k * STEP_S * 1e9), x, y, theta))
        sign = 1.0 if back_at is None or k < back_at else -1.0
        theta += sign * turning * STEP_S
        x += sign * speed * STEP_S * math.cos(theta)
        y += sign * speed * STEP_S * math.sin(theta)
    return readings


def sound(readings):
    found = StaleOdometryFilter()
    kept = [reading for each in readings for reading in found.add(each)]
    return [*kept, *found.flush()], found.dropped


@pytest.mark.parametrize("back_at", [None, 40])
def test_nothing_is_left_out_of_a_sound_drive(back_at):
    readings = drive(back_at=back_at)
    assert sound(readings) == (readings, 0)


@pytest.mark.parametrize("age", [10, 17, 29])
def test_a_pose_of_a_second_ago_and_more_is_left_out(age):
    readings = drive()
    old = readings[50 - age]
    late = WheelOdometry(readings[50].stamp_ns, old.x, old.y, old.theta)
    kept, dropped = sound([*readings[:50], late, *readings[51:]])
    assert dropped == 1
    assert kept == [*readings[:50], *readings[51:]]


def test_a_jump_that_stays_is_no_stale_reading():
    readings = drive()
    jumped = [WheelOdometry(r.stamp_ns, r.x + 1.0, r.y, r.theta) for r in readings[50:]]
    kept, dropped = sound([*readings[:50], *jumped])
    assert dropped == 0
    assert kept == [*readings[:50], *jumped]


def test_the_last_reading_is_handed_on_even_in_doubt():
    readings = drive()
    old = readings[30]
    late = WheelOdometry(readings[-1].stamp_ns, old.x, old.y, old.theta)
    assert sound([*readings[:-1], late])[0] == [*readings[:-1], late]
