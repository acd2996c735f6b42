"""What a page carries for its scripts: columns of numbers and one compressed document."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_LARGEST = (
    1e11  # of a value, so that all its digits are exact in a script; poses are not so far off
)
MOST_POINTS = 20_000  # of one path or curve: about 0.5 MB of page for a path with all its columns


def column(values: Values, decimals: int) -> dict[str, Any]:
    """Round to so many decimals and keep the steps from value to value.

    Neighbours are alike along a path and along a scan, so that steps are short and compress
    well.  What is not finite, or absurdly large, becomes null.
    """
    scale = 10**decimals
    good = np.abs(values) < _LARGEST  # False for nan
    steps: list[int | None] = [None] * len(values)
    rounded = np.round(values[good] * scale).astype(np.int64)
    for row, step in zip(np.flatnonzero(good), np.diff(rounded, prepend=0).tolist(), strict=True):
        steps[row] = step
    return {"scale": scale, "steps": steps}


def pack(document: Any) -> str:
    """Return JSON, compressed, as text that can stand in a page; `unpack` in data.js reads it."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(zlib.compress(text.encode("utf-8"))).decode("ascii")


def shown_rows(n: int, always: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows of n that a page has room for: all, or evenly spread with some that must not miss."""
    if n <= MOST_POINTS:
        return np.arange(n)
    spread = np.linspace(0, n - 1, MOST_POINTS).astype(np.intp)
    return np.unique(np.concatenate([spread, always]))
