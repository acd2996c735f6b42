"""Compiles the pipeline's kernels before a robot waits for them."""

from __future__ import annotations

import numpy as np

from logs.messages import LaserMount, LaserScan, Message, WheelOdometry
from slam.config import SlamConfig
from slam.offline import run_offline

_ROOM_M = (4.0, 3.0)  # half length and half width of the room that is measured
_BEAMS, _STEP_S, _STEP_M = 181, 0.1, 0.1
_SCANS = 40


def warm_up(config: SlamConfig) -> None:
    """Map an imaginary room; takes half a minute the first time, and half a second ever after.

    The room is driven to and fro once; a leap of the odometry calls for the search.
    """
    again = {"min_path_m": 1.0, "every_m": 0.3, "enabled": config.loops.enabled}
    loops = config.loops.model_copy(update=again)
    run_offline(lambda: _drive(), config.model_copy(update={"loops": loops}))


def _drive() -> list[Message]:
    messages: list[Message] = [LaserMount(0, 0.0, 0.0, 0.0)]
    for k in range(_SCANS):
        x = _STEP_M * min(k, _SCANS - k) - 1.0
        stamp = round(k * _STEP_S * 1e9)
        leap = 0.8 if k > _SCANS // 4 else 0.0
        messages.append(WheelOdometry(stamp, x + leap, 0.0, 0.0))
        messages.append(_scan(stamp, x))
    return messages


def _scan(stamp_ns: int, x: float) -> LaserScan:
    """Measure the room from (x, 0)."""
    bearings = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _BEAMS)
    cos, sin = np.cos(bearings), np.sin(bearings)
    with np.errstate(divide="ignore"):
        to_end = (np.where(cos > 0, _ROOM_M[0], -_ROOM_M[0]) - x) / cos
        to_side = _ROOM_M[1] / np.abs(sin)
    ranges = np.minimum(to_end, to_side).astype(np.float32)
    ranges[60:66] -= np.float32(0.4)  # a post, so that the walls are not all there is
    return LaserScan(stamp_ns, -0.5 * np.pi, np.pi / (_BEAMS - 1), ranges, 0.02, 30.0)
