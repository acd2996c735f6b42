"""Compiles the kernels of the mapping before a robot waits for them."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from slam.logs.messages import LaserExtrinsics, Message, WheelOdometry
from slam.mapping.config import SlamConfig
from slam.runs.kernel_warmup.second_process import (
    compile_matcher,
    compiled,
    compiling_in_second_process,
    kept_on_disk,
)
from slam.runs.kernel_warmup.simulated_room import measure_room
from slam.runs.machine import usable_cores
from slam.runs.offline import run_offline

_STEP_S, _STEP_M = 0.1, 0.1
_SCANS = 40


def warm_up(config: SlamConfig) -> None:
    """Map an imaginary room; takes some 20 s the first time, and half a second after that.

    The robot drives to and fro once; a jump of the odometry makes the loop search run.
    """
    with _no_collector():
        if usable_cores() > 1 and kept_on_disk() and not compiled():
            with compiling_in_second_process():
                compile_matcher()
        run_offline(lambda: _drive(), _in_the_room(config))


@contextmanager
def _no_collector() -> Iterator[None]:
    """A compiler makes millions of objects that are all in use: looking for others is a tenth."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _in_the_room(config: SlamConfig) -> SlamConfig:
    """The methods of the settings, but the shipped limits: others may leave nothing to match."""
    shipped = SlamConfig()
    loops = shipped.loops.model_copy(update={"min_path_m": 1.0, "every_m": 0.3})
    methods = {
        name: getattr(shipped, name).model_copy(update={"method": getattr(config, name).method})
        for name in ("matcher", "keyframes")
    }
    # Placing every scan needs no further kernel, only a search tree, whose import takes long.
    localise = shipped.localise.model_copy(update={"every_scan": False})
    return shipped.model_copy(update={"loops": loops, "localise": localise, **methods})


def _drive() -> list[Message]:
    messages: list[Message] = [LaserExtrinsics(0, 0.0, 0.0, 0.0)]
    for k in range(_SCANS):
        x = _STEP_M * min(k, _SCANS - k) - 1.0
        stamp = round(k * _STEP_S * 1e9)
        jump = 0.8 if k > _SCANS // 4 else 0.0
        messages.append(WheelOdometry(stamp, x + jump, 0.0, 0.0))
        messages.append(measure_room(stamp, x))
    return messages
