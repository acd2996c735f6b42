"""`slam bench growth`: how the time of a keyframe and memory grow over a drive without end."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import radians
from typing import Any

import numpy as np
from slam.drivers.simulators.blocks import blocks
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LaserConfig
from slam.drivers.simulators.worlds import Scenario

from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.mapping.stage_timer import NullTimer

SIZES = (1000, 3000, 10_000)  # keyframes
WINDOW = 500  # latest keyframes over which the figures of a size are taken
TOWN = (8, 8)  # blocks: 4 km of way, more than the largest size needs
# Few beams and a scan each 0.3 m make the drive cheap to simulate; matching is cheaper for it,
# but what grows with the graph is not.
LASER = LaserConfig(
    beams=91, angle_min=radians(-90.0), angle_step=radians(2.0), range_max=15.0, rate_hz=2.0
)
STAGES = ("matching", "optimising", "closing")


class CpuWatch(NullTimer):
    """CPU seconds of each stage since it was last asked: other programs do not count."""

    def __init__(self) -> None:
        self._seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Enclose a piece of work that belongs to `stage`."""
        begin = time.process_time()
        try:
            yield
        finally:
            self._seconds[stage] += time.process_time() - begin

    def take(self) -> list[float]:
        """Milliseconds of `STAGES` since the last call."""
        taken = [1e3 * s for s in self._seconds.values()]
        self._seconds = dict.fromkeys(STAGES, 0.0)
        return taken


def bench_growth(quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Drive through a town until the graph has grown to each size; `quick` ends at the first.

    The pipeline is the one that ships, with loop searches inside the step.
    """
    sizes = SIZES[:1] if quick else SIZES
    world, way = blocks(*TOWN, np.random.default_rng(1))
    watch = CpuWatch()
    slam = Slam(SlamConfig(), watch)
    times: list[list[float]] = []  # per keyframe: whole step, then the stages
    rows: list[dict[str, Any]] = []
    for message in simulate(Scenario("blocks", world, way), LASER, seed=1):
        before, begin = len(slam.keyframes), time.process_time()
        slam.step(message)
        spent, stages = 1e3 * (time.process_time() - begin), watch.take()
        if len(slam.keyframes) == before:
            continue
        times.append([spent, *stages])
        if len(slam.keyframes) >= sizes[len(rows)]:
            rows.append(_row(slam, np.array(times[-WINDOW:])))
            echo(f"{len(slam.keyframes)} keyframes")
            if len(rows) == len(sizes):
                break
    return {"meta": {"window": WINDOW, "beams": LASER.beams, "time": "CPU ms"}, "rows": rows}


def _row(slam: Slam, times: np.ndarray[Any, Any]) -> dict[str, Any]:
    assert slam.graph is not None
    row: dict[str, Any] = {
        "keyframes": len(slam.keyframes),
        "closures": sum(edge.kind == "loop" for edge in slam.graph.edges),
        "way_m": slam.keyframes[-1].travelled_m,
    }
    for name, column in zip(("step", *STAGES), times.T, strict=True):
        p50, p99 = np.percentile(column, [50, 99])
        row |= {f"{name}_ms_p50": float(p50), f"{name}_ms_p99": float(p99)}
        row[f"{name}_ms_mean"] = float(column.mean())
        row[f"{name}_ms_max"] = float(column.max())
    row["rss_mb"] = _resident_mb()
    return row


def _resident_mb() -> float:
    """Peak resident memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
