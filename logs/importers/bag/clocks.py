"""Stamps that are missing, drives that follow each other, clocks that disagree: pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError
from slam.logs.importers.bag.topics import Said

RESET_S = 1.0
"""Stamps that step back by more begin a new drive; less is disorder, which is sorted away.

The public log of the Intel laboratory runs backwards by up to 0.9 s.
"""

APART_S = 2.0
"""Clocks of laser and robot that differ by more give no usable odometry at a scan."""

NOTABLE_APART_S = 0.25
"""A difference that is told: at 0.5 m/s it moves scans by 12 cm."""

YEAR_2000_NS = 946_684_800 * 10**9  # earlier stamps are a simulator's, or of an unset clock
_STRAYS = 3  # messages in a row that may bear stamps far off without being a drive of their own
_PAIRS = 2000  # looked at to compare two clocks
_MENDS = "--use-receipt-time goes by the times of receipt instead"

Stamps = NDArray[np.int64]


class Stamped(NamedTuple):
    """Stamps of one stream, in file order, and which of its messages can be used."""

    stamps: Stamps  # (n,) ns
    usable: NDArray[np.bool_]  # (n,)


def effective(
    name: str,
    stamps: Stamps,
    receipts: Stamps,
    flawed: Sequence[int],
    by_receipt: bool,
    said: Said,
    skipped: Counter[str],
) -> Stamped:
    """Return the stamps to go by: times of receipt where asked for, or where there is none.

    Raises:
        LogError: times of receipt are wanted and there are none.
    """
    usable = np.ones(len(stamps), dtype=np.bool_)
    usable[list(flawed)] = False
    if by_receipt:
        if not receipts.any():
            raise LogError(f"{name} has no times of receipt: leave --use-receipt-time out")
        return Stamped(receipts.copy(), usable)
    missing = usable & (stamps == 0)
    if not missing.any():
        return Stamped(stamps, usable)
    known = usable & (stamps > 0)
    simulated = known.any() and np.median(stamps[known]) < YEAR_2000_NS
    if simulated and np.median(np.abs(receipts[known] - stamps[known])) > 1e15:
        # The simulated clock starts at zero: one such stamp is the first moment of it.
        first = int(np.flatnonzero(missing)[0])
        missing[first] = missing[first] and stamps[known][0] > RESET_S * 1e9
        if missing.any():
            skipped[f"{name}: stamp zero, before the simulated clock ran"] += int(missing.sum())
            usable = usable & ~missing
        return Stamped(stamps, usable)
    if not receipts[missing].all():
        skipped[f"{name}: stamp zero, and no time of receipt"] += int(missing.sum())
        return Stamped(stamps, usable & ~missing)
    said.warnings.append(f"{name}: {int(missing.sum())} x stamp zero, time of receipt taken")
    return Stamped(np.where(missing, receipts, stamps), usable)


def drives_of(stamps: Stamps, usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the number of the drive that each message belongs to, (n,), from 0; -1: to none.

    A new drive begins where stamps step back by more than RESET_S and stay there.  A few
    stamps far ahead of all that follow are no drive: they belong to none.
    """
    numbers = np.full(len(stamps), -1, dtype=np.int64)
    rows = np.flatnonzero(usable).tolist()
    values = stamps[rows].tolist()
    reset = int(RESET_S * 1e9)
    drive, top = 0, -1
    tops: list[int] = []  # latest stamp before each message of this drive
    for k, value in enumerate(values):
        if value < top - reset:
            stray = next(
                (b for b in range(1, min(_STRAYS, len(tops)) + 1) if value >= tops[-b] - reset),
                None,
            )
            if stray is not None and len(tops) >= stray:
                for back in range(1, stray + 1):
                    if values[k - back] > value + reset:
                        numbers[rows[k - back]] = -1
                top = tops[-stray]
                tops = tops[:-stray]
            elif all(later < top - reset for later in values[k + 1 : k + 1 + _STRAYS]):
                drive, top, tops = drive + 1, -1, []
        tops.append(top)
        top = max(top, value)
        numbers[rows[k]] = drive
    return numbers


def difference_s(
    stamps: Stamps, receipts: Stamps, other: Stamps, other_receipts: Stamps
) -> float | None:
    """Return by how much the second clock is ahead of the first, judged by receipt (s).

    None if times of receipt tell nothing: there are none, or they do not overlap.
    """
    if len(stamps) < 2 or len(other) < 2 or _mute(receipts) or _mute(other_receipts):
        return None
    order = np.argsort(other_receipts, kind="stable")
    there = other_receipts[order]
    within = (receipts >= there[0]) & (receipts <= there[-1])
    rows = np.flatnonzero(within)[:: max(1, int(within.sum()) // _PAIRS)]
    if not len(rows):
        return None
    after = np.minimum(np.searchsorted(there, receipts[rows]), len(there) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(there[after] - receipts[rows] < receipts[rows] - there[before], after, before)
    apart = (other[order][nearer] - stamps[rows]) - (there[nearer] - receipts[rows])
    return float(np.median(apart)) * 1e-9


def seconds_in_words(value: float) -> str:
    """Write a difference of clocks, its sign left out."""
    return f"{abs(value):.0f} s" if abs(value) >= 100 else f"{abs(value):.3g} s"


def _mute(receipts: Stamps) -> bool:
    return bool(receipts.max() == receipts.min())


def compare_clocks(
    names: tuple[str, str],
    scans: Stamped,
    scan_receipts: Stamps,
    wheels: Stamped,
    wheel_receipts: Stamps,
    said: Said,
) -> None:
    """Refuse scans and odometry that were stamped by clocks too far apart.

    Raises:
        LogError: they differ by more than APART_S, or their times do not overlap at all.
    """
    first, second = scans.usable, wheels.usable
    if not first.any() or not second.any():
        return
    between = " and ".join(names)
    apart = difference_s(
        scans.stamps[first], scan_receipts[first], wheels.stamps[second], wheel_receipts[second]
    )
    if apart is not None and abs(apart) > APART_S:
        raise LogError(
            f"clocks of {between} differ by {seconds_in_words(apart)}, judged by the times of "
            f"receipt: set the clocks; {_MENDS}"
        )
    a, b = scans.stamps[first], wheels.stamps[second]
    gap = max(int(a.min()) - int(b.max()), int(b.min()) - int(a.max())) * 1e-9
    if gap > APART_S:
        raise LogError(
            f"{between} do not overlap: their stamps lie {seconds_in_words(gap)} apart; "
            f"{_MENDS}, --odom none leaves the odometry out"
        )
    if apart is not None and abs(apart) > NOTABLE_APART_S:
        said.warnings.append(
            f"clocks of {between} differ by {seconds_in_words(apart)}, judged by the times of "
            f"receipt: {_MENDS}"
        )
