"""Scans of ROS as scans of ours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.logs.importers.bag.inventory import is_turned
from slam.logs.messages import LaserScan


def scan_of(message: Any, stamp_ns: int) -> LaserScan:
    """Return a sensor_msgs/LaserScan or MultiEchoLaserScan with ranges after our rules.

    Of several echoes of a beam the first counts.  The rules are those of `rosbag`.
    """
    ranges = (
        np.array(message.ranges, dtype=np.float32)
        if isinstance(message.ranges, np.ndarray)
        else _first_echoes(message.ranges)
    )
    low, high = float(message.range_min), float(message.range_max)
    with np.errstate(invalid="ignore"):
        if high > 0:
            ranges[ranges >= high] = np.inf
        ranges[(ranges < low) | (ranges <= 0)] = np.nan  # -inf is among these
    step = float(message.angle_increment)
    return LaserScan(
        stamp_ns,
        float(message.angle_min),
        -step if is_turned(message) else step,
        ranges,
        low,
        high if high > 0 else float("inf"),
        float(message.time_increment),
    )


def _first_echoes(beams: Any) -> NDArray[np.float32]:
    """Return the first echo of each beam; a beam without any saw nothing come back."""
    return np.array(
        [beam.echoes[0] if len(beam.echoes) else np.inf for beam in beams], dtype=np.float32
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
