"""Which drive of a recording is read, and which part of it."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError
from slam.logs.importers.bag.clocks import Stamped, drives_of
from slam.logs.importers.wishes import Wishes


def pick_drive(
    streams: list[tuple[str, Stamped]], wishes: Wishes, skipped: Counter[str], changed: Counter[str]
) -> list[NDArray[np.bool_]]:
    """Return which messages of each stream belong to the drive and the span asked for.

    Drives are counted by stamps that step back in file order (see `clocks.drives_of`).

    Raises:
        LogError: there are several drives and none is asked for, or not the one asked for.
    """
    numbers = [drives_of(stamped.stamps, stamped.usable) for _, stamped in streams]
    counts = [int(number.max()) + 1 for number in numbers if len(number) and number.max() >= 0]
    for (name, stamped), number in zip(streams, numbers, strict=True):
        if strays := int(np.count_nonzero(stamped.usable & (number < 0))):
            skipped[f"{name} with stamps far ahead of all that follow"] += strays
    if len(set(counts)) > 1:
        raise LogError(
            f"{_steps_back(streams, numbers)}, but not in all streams: the clocks cannot be told "
            "apart; --use-receipt-time goes by the times of receipt"
        )
    drives = counts[0] if counts else 1
    if drives > 1 and not wishes.drive:
        raise LogError(
            f"holds {drives} drives: {_steps_back(streams, numbers)}; name one of "
            f"{_listed(streams, numbers, drives)} with --drive N, or go by the times of receipt "
            "with --use-receipt-time"
        )
    if wishes.drive > drives:
        raise LogError(f"has no drive {wishes.drive}: it holds {drives}")
    wanted = max(wishes.drive, 1) - 1
    keeps = [number == wanted for number in numbers]
    if drives > 1:
        others = sum(int(np.count_nonzero(n >= 0)) for n in numbers) - sum(map(np.sum, keeps))
        changed[f"messages of other drives than drive {wanted + 1}, left out"] += int(others)
    return _within(streams, keeps, wishes)


def _within(
    streams: list[tuple[str, Stamped]], keeps: list[NDArray[np.bool_]], wishes: Wishes
) -> list[NDArray[np.bool_]]:
    """Narrow down to the span of time asked for, counted from the first message of the drive."""
    if wishes.start_s == 0.0 and math.isinf(wishes.end_s):
        return keeps
    firsts = [
        s.stamps[keep].min() for (_, s), keep in zip(streams, keeps, strict=True) if keep.any()
    ]
    first = int(min(firsts))
    narrowed = []
    for (_, stamped), keep in zip(streams, keeps, strict=True):
        seconds = (stamped.stamps - first) * 1e-9
        narrowed.append(keep & (seconds >= wishes.start_s) & (seconds <= wishes.end_s))
    if not narrowed[0].any():
        raise LogError(
            f"holds no scan from {wishes.start_s:g} to {wishes.end_s:g} s after its first message"
        )
    return narrowed


def _steps_back(streams: list[tuple[str, Stamped]], numbers: list[NDArray[np.int64]]) -> str:
    """Say where time first steps back, and by how much."""
    for (name, stamped), number in zip(streams, numbers, strict=True):
        rows = np.flatnonzero(number >= 0)
        changes = np.flatnonzero(np.diff(number[rows]) > 0)
        if len(changes):
            at = rows[changes[0] + 1]
            back = int(stamped.stamps[rows[: changes[0] + 1]].max()) - int(stamped.stamps[at])
            return f"time steps back by {back * 1e-9:.3g} s after {changes[0] + 1} {name}"
    return "time steps back"


def _listed(
    streams: list[tuple[str, Stamped]], numbers: list[NDArray[np.int64]], drives: int
) -> str:
    """Name the drives by what they hold; the first few of many."""
    (_, stamped), number = streams[0], numbers[0]
    texts = []
    for drive in range(min(drives, 6)):
        own = stamped.stamps[number == drive]
        seconds = (own.max() - own.min()) * 1e-9 if len(own) else 0.0
        texts.append(f"{drive + 1} ({len(own)} scans, {seconds:.1f} s)")
    return ", ".join(texts) + (", ..." if drives > 6 else "")
