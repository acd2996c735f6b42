"""What a message must be like to be used at all; the rest is counted and left out."""

from __future__ import annotations

import math

from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry

_FINEST_RAD = 1e-6  # from beam to beam; the finest lasers have 1e-3
_FARTHEST_M = 1e7  # from where the odometry began: a quarter of the way round the earth
_WIDEST_RAD = 2.1 * math.pi  # a full turn, and some rounding


def validate_message(message: Message) -> str:
    """Why a message cannot be used, in words; empty if it can.

    Readings that are nan, negative or infinite are no flaw of a scan: such beams saw nothing.
    """
    if isinstance(message, WheelOdometry) and not _finite(message.x, message.y, message.theta):
        return "odometry that is not finite"
    if isinstance(message, WheelOdometry) and max(abs(message.x), abs(message.y)) > _FARTHEST_M:
        return "odometry where no robot can be"
    if isinstance(message, LaserExtrinsics) and not _finite(message.x, message.y, message.theta):
        return "laser mount that is not finite"
    if isinstance(message, LaserScan):
        span = message.angle_step * max(len(message.ranges) - 1, 0)
        known = _finite(message.angle_min, span) and not math.isnan(message.range_max)
        if not known or abs(message.angle_step) < _FINEST_RAD or abs(span) > _WIDEST_RAD:
            return "scan whose beams have no possible direction"
    return ""


def _finite(*numbers: float) -> bool:
    return all(map(math.isfinite, numbers))
