"""Single ROS messages as messages of ours."""

from __future__ import annotations

from typing import Any

import numpy as np
from slam.logs.messages import LaserScan


def stamp_of(stamp: Any) -> int:
    """Return a builtin_interfaces/Time as nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def scan_of(message: Any) -> LaserScan:
    """Return a sensor_msgs/LaserScan with ranges after our rules (see `rosbag`)."""
    ranges = np.array(message.ranges, dtype=np.float32)
    low, high = float(message.range_min), float(message.range_max)
    with np.errstate(invalid="ignore"):
        if high > 0:
            ranges[ranges >= high] = np.inf
        ranges[(ranges < low) | (ranges <= 0)] = np.nan  # -inf is among these
    return LaserScan(
        stamp_of(message.header.stamp),
        float(message.angle_min),
        float(message.angle_increment),
        ranges,
        low,
        high if high > 0 else float("inf"),
        float(message.time_increment),
    )


def mirrored(scan: LaserScan) -> LaserScan:
    """Return the scan of a laser that hangs upside down, as seen from above."""
    return LaserScan(
        scan.stamp_ns,
        -scan.angle_min,
        -scan.angle_step,
        scan.ranges,
        scan.range_min,
        scan.range_max,
        scan.beam_period_s,
    )
