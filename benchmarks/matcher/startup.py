"""How long the kernels take to compile when nothing is cached, and how long a start takes then."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from benchmarks.matcher.peers import BenchError

LIMIT_S = 300.0

# The matcher is what `match` and `prepare` need; the pipeline has loop search and maps besides.
MATCHER = """
import numpy as np
from gtsam import Pose2
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import match
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan
bearings = np.linspace(-1.5, 1.5, 181)
ranges = np.minimum(4.0 / np.cos(bearings), 3.0 / np.maximum(np.abs(np.sin(bearings)), 1e-3))
scan = LaserScan(0, -1.5, 3.0 / 180, ranges.astype(np.float32))
seen = prepare(scan, LaserExtrinsics(0, 0.0, 0.0, 0.0), ScanConfig())
for method in ("point_to_line", "point_to_point", "ndt", "psm"):
    match([Reference(Pose2(), seen)], seen, Pose2(), MatchConfig(method=method))
"""
PIPELINE = """
from slam.mapping.config import SlamConfig
from slam.runs.kernel_warmup.warmup import warm_up
warm_up(SlamConfig())
"""


def startup() -> dict[str, float]:
    """Seconds from the start of Python to the end of the first use, without and with a cache."""
    figures = {}
    for name, program in (("matcher", MATCHER), ("pipeline", PIPELINE)):
        with tempfile.TemporaryDirectory() as cache:
            figures[f"{name}_cold_s"] = _run(program, cache)
            figures[f"{name}_second_s"] = _run(program, cache)
    return figures


def _run(program: str, cache: str) -> float:
    begin = time.perf_counter()
    try:
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            check=True,
            capture_output=True,
            timeout=LIMIT_S,
        )
    except subprocess.SubprocessError as error:
        raise BenchError(f"a process that should compile the kernels failed: {error}") from error
    return time.perf_counter() - begin
