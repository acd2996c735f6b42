"""Matches many scans among keyframes at once, as `match` does one, to the bit.

What Python adds to a match costs more than the match itself, and holds the interpreter's lock: here
a whole batch is one call of a kernel, which other threads may run beside.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.frontend.align_kernels import align
from slam.frontend.batch_kernels import FOUND, align_each, views
from slam.frontend.kernel_address import Address
from slam.frontend.match_types import MatchConfig, Matrix
from slam.frontend.matching import NO_STARTS
from slam.frontend.scan import PreparedScan

Rows = NDArray[np.int64]


def can_be_batched(keyframes: Sequence[PreparedScan], config: MatchConfig) -> bool:
    """Whether `match_each` serves these settings, and lasers all of one resolution."""
    table = keyframes[0].alone[2]  # shared by scans of one beam spacing
    return config.method == "point_to_line" and all(
        k.valid > 2 and k.alone[2] is table for k in keyframes
    )


def view_of_each(scans: Sequence[PreparedScan], guesses: Matrix) -> Matrix:
    """(n, 4) m, what each scan looks at and where it is taken, at map_T_base (n, 3)."""
    out = np.empty((len(scans), 4))
    views(guesses, np.array([scan.centre for scan in scans]), out)
    return out


def match_each(
    scans: Sequence[PreparedScan], guesses: Matrix, keyframes: Sequence[PreparedScan],
    poses: Matrix, near: Rows, covariance: Matrix, config: MatchConfig,
) -> Matrix:  # fmt: skip
    """Match scans from their guesses, each among `near` (n, k) of the keyframes (m).

    Args:
        scans: n of them.
        guesses: (n, 3) map_T_base, also the middle of the prior.
        keyframes: for which `can_be_batched` holds.
        poses: (m, 3) map_T_base of the keyframes.
        near: (n, k) rows of the keyframes for each scan.
        covariance: (3, 3) of the error of a guess, in its own frame (m, m, rad).
        config: of the matcher.

    Returns:
        (n, FOUND) columns as in `batch_kernels`; no pairs where a match was not possible.
    """
    found = np.zeros((len(scans), FOUND))
    source = (
        np.concatenate([s.points for s in scans]),
        np.concatenate([s.lines for s in scans]),
        np.concatenate([s.flags for s in scans]),
        _starts([s.points for s in scans]),
        np.array([s.geometry for s in scans]),
        np.array([s.valid for s in scans]),
    )
    store = (
        np.concatenate([k.points for k in keyframes]),
        np.concatenate([k.lines for k in keyframes]),
        np.concatenate([k.windows for k in keyframes]),
        np.concatenate([k.flags for k in keyframes]),
        _starts([k.points for k in keyframes]),
        np.array([k.geometry for k in keyframes]),
        keyframes[0].alone[2],
        poses,
    )
    align_each(
        _address(), source, store, near, guesses, covariance, config.passes_with_prior, NO_STARTS,
        config.limits, found,
    )  # fmt: skip
    return found


def _starts(arrays: Sequence[Any]) -> Rows:
    return np.array([0, *accumulate(map(len, arrays))])


@lru_cache(maxsize=1)
def _address() -> Address:
    """`align` for the types that `match` hands it."""
    points, lines, windows = np.empty((1, 2)), np.empty((1, 5)), np.empty((1, 2), np.int32)
    flags, geometries, table = np.empty(1, np.uint8), np.empty((1, 5)), np.empty((1, 1))
    geometry = np.empty(5)
    for array in (points, lines, windows, flags, geometries, table, geometry):
        array.setflags(write=False)  # as those of a prepared scan are
    zero, shipped = (0.0, 0.0, 0.0), MatchConfig()
    references = points, lines, windows, flags, np.zeros(2, np.int64), geometries, table, points + 0
    return Address(
        align,
        (
            (points, lines, flags, geometry), references, zero, (zero, np.eye(3), True),
            shipped.passes_with_prior, NO_STARTS, shipped.limits,
        ),
    )  # fmt: skip
