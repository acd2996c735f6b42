"""Compiles half of the kernels in a second process, whose program this module is.

Both keep what they compile in the cache on disk, where each finds what the other has compiled.
"""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from gtsam import Pose2

from slam.frontend.align_kernels import align
from slam.frontend.correlative import CorrelativeConfig, Window, build_field, search
from slam.frontend.covariance_kernels import own_information
from slam.frontend.match_arrays import SYSTEM, References, Source
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare, reach_table
from slam.frontend.scatter_kernels import scatter
from slam.logs.messages import LaserExtrinsics
from slam.maps.occupancy import build_map
from slam.runs.kernel_warmup.simulated_room import measure_room

_PATIENCE_S = 120.0


def compiled() -> bool:
    """Whether the matcher has been compiled and kept, from the sources as they are."""
    source = Path(align.py_func.__code__.co_filename)
    return kept_on_disk() and any(
        Path(align.stats.cache_path).glob(f"{source.stem}.align-*.nbi")  # the folder is by sources
    )


def kept_on_disk() -> bool:
    """Whether there is a cache at all, through which two processes can share their kernels."""
    return align.stats.cache_path is not None


@contextmanager
def compiling_in_second_process() -> Iterator[None]:
    """Have a second process compile its share meanwhile, and wait for it at the end.

    If it fails, what is missing is compiled at its first use.
    """
    quiet = subprocess.DEVNULL
    child = subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=quiet, stdout=quiet, stderr=quiet
    )
    try:
        yield
        with suppress(subprocess.TimeoutExpired):
            child.wait(_PATIENCE_S)
    finally:
        child.kill()
        child.wait()


def compile_matcher() -> None:
    """Compile all that a match needs, by a match that is refused."""
    scan = blank_scan()
    match([Reference(Pose2(), scan)], scan, Pose2(), MatchConfig())


def compile_share() -> None:
    """Call each kernel of this share with the types that the mapping and the matcher use.

    First those that the matcher needs last, then the kernels that come after it.
    """
    scan = blank_scan()
    poses, gradient = np.zeros((1, 3)), np.zeros(6)
    pairs = np.full((1, len(scan.points)), -1, np.int32)
    source = Source(scan.points, scan.lines, scan.flags, scan.geometry)
    references = References(scan.points, scan.lines, scan.windows, scan.flags, *scan.alone, poses)
    scatter(source, references, poses[0], pairs, 0.04, 0.01, gradient)
    own_information(np.zeros(SYSTEM), gradient, 1e-4, 0.0, 0.0, np.empty((3, 3)))
    room = measure_room(0, 0.0)
    seen = prepare(room, LaserExtrinsics(0, 0.0, 0.0, 0.0), ScanConfig())
    points = seen.points.copy()  # which may be written to, as those of a submap
    search(build_field(points, CorrelativeConfig()), points, Window(Pose2(), 0.5, 0.1), 0.1)
    build_map([room], np.zeros((1, 3)))


def blank_scan(beams: int = 20) -> PreparedScan:
    """A scan without points that claims to have some, with arrays of the types of `prepare`.

    With it the matcher is compiled before the kernels that prepare a scan are.
    """
    points, lines = np.full((beams, 2), np.nan), np.zeros((beams, 5))
    windows, flags = np.zeros((beams, 2), np.int32), np.zeros(beams, np.uint8)
    geometries, centre = np.array([[0.0, 0.01, 0.0, 0.0, 628.0]]), np.zeros(2)
    for array in (points, lines, windows, flags, geometries, centre):
        array.setflags(write=False)
    reach2 = reach_table(0.01)
    alone = np.array([0, beams]), geometries, reach2
    return PreparedScan(
        0, points, lines, windows, flags, geometries[0], beams, centre, reach2[0], alone
    )


if __name__ == "__main__":
    gc.disable()  # as in `warm_up`
    compile_share()
