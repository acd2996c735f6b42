"""From an inventory to what is read: the choices, the clock, the drive, and the order."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag import clocks, wheels
from slam.logs.importers.bag.clocks import Stamped
from slam.logs.importers.bag.inventory import Inventory, Stream
from slam.logs.importers.bag.mounts import choose_mount
from slam.logs.importers.bag.odometry import Odometry
from slam.logs.importers.bag.topics import Said, choose_odometry, choose_scan
from slam.logs.importers.bag.transforms import Mount
from slam.logs.importers.drives import pick_drive
from slam.logs.importers.wishes import Wishes, check_span
from slam.logs.messages import WheelOdometry

DROPPED = -1  # in place of a stamp


@dataclass(frozen=True, eq=False, slots=True)
class Choice:
    """What is read of a recording, and why."""

    scan: Stream
    odometry: Odometry | None
    base: str
    mount: Mount
    said: Said


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """Everything of a recording but its scans, and where those belong."""

    choice: Choice
    scan_stamps: NDArray[np.int64]  # (n,) ns, one for each scan in file order; DROPPED: not read
    scan_ranks: NDArray[np.int64]  # (n,) place among all messages that are written
    odometry: list[tuple[int, int, WheelOdometry]]  # rank, time of receipt, message; by rank


def choose(inventory: Inventory, wishes: Wishes) -> Choice:
    """Choose scans, odometry, base and mount; pure.

    Raises:
        LogError: there is no scan, what was asked for is not there, or the mount cannot be told.
    """
    said = Said()
    scan = choose_scan(inventory, wishes, said)
    said.notes.append(f"scans from {shown(scan.topic)}")
    odometry = choose_odometry(inventory, wishes, scan, said)
    said.notes.append(f"odometry from {odometry.name}" if odometry else "no odometry: laser alone")
    base, mount = choose_mount(inventory.tree, scan.frame, odometry, wishes, said)
    return Choice(scan, odometry, base, mount, said)


def make_plan(
    inventory: Inventory, wishes: Wishes, skipped: Counter[str], changed: Counter[str]
) -> Plan:
    """Settle stamps, drive and order.

    Raises:
        LogError: as `choose`; or the clocks do not fit, or there are several drives and none
            is asked for.
    """
    check_span(wishes)
    choice = choose(inventory, wishes)
    scans, scan_receipts = _scans(choice, wishes, skipped, changed)
    rows = _Wheels(choice.odometry, wishes, choice.said, skipped)
    if choice.odometry is not None and not wishes.receipt_time:
        clocks.compare_clocks(
            (shown(choice.scan.topic), choice.odometry.name),
            scans, scan_receipts, rows.stamped, rows.receipts, choice.said,
        )  # fmt: skip
    keep_scans, keep_rows = pick_drive(
        [("scans", scans), ("odometry messages", rows.stamped)], wishes, skipped, changed
    )
    rows.settle(keep_rows, skipped, changed)
    stamps = np.where(keep_scans, scans.stamps, DROPPED)
    _count_disorder(stamps[keep_scans], rows.stamped.stamps[rows.kept], changed)
    return _ordered(choice, stamps, rows)


def _scans(
    choice: Choice, wishes: Wishes, skipped: Counter[str], changed: Counter[str]
) -> tuple[Stamped, NDArray[np.int64]]:
    stream = choice.scan
    stamps, receipts = stream.arrays()
    flaws = dict(stream.flaws)
    number = list(stream.frames).index(stream.frame)
    for k in np.flatnonzero(np.array(stream.frame_numbers) != number).tolist():
        flaws.setdefault(k, "scan of another frame on the same topic")
    skipped.update(flaws.values())
    if stream.turned:
        choice.said.warnings.append(
            f"{shown(stream.topic)}: {stream.turned} scans end at angle_max only if their "
            "increment is turned round, so it is"
        )
    if stream.kind.endswith("MultiEchoLaserScan"):
        choice.said.notes.append("multi-echo: first echo taken")
    digests = np.array(stream.digests, dtype=np.int64)
    again = _again(np.stack([stamps, digests], axis=1), stamps)
    again[list(flaws)] = False
    if again.any():
        changed["scans recorded twice, one kept"] += int(again.sum())
        flaws.update(dict.fromkeys(np.flatnonzero(again).tolist(), ""))
    stamped = clocks.effective(
        shown(stream.topic),
        stamps,
        receipts,
        list(flaws),
        wishes.receipt_time,
        choice.said,
        skipped,
    )
    if not stamped.usable.any():
        raise LogError(f"no usable scan: {sum(skipped.values())} x {next(iter(skipped))}")
    return stamped, receipts


def _again(rows: NDArray[Any], stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which rows, (n, k), repeat the one before, whose stamp is the same and not zero."""
    again = np.zeros(len(rows), dtype=np.bool_)
    again[1:] = (rows[1:] == rows[:-1]).all(axis=1)
    return again & (stamps > 0)


class _Wheels:
    """The odometry on its way into the plan."""

    def __init__(
        self, odometry: Odometry | None, wishes: Wishes, said: Said, skipped: Counter[str]
    ) -> None:
        if odometry is None:
            none = np.zeros(0, dtype=np.int64)
            self.receipts, self.poses = none, np.zeros((0, 3))
            self.stamped = Stamped(none, none.astype(np.bool_))
        else:
            self.receipts, self.poses = odometry.receipts, odometry.poses
            skipped.update(odometry.flaws.values())
            again = _again(np.column_stack([odometry.stamps, odometry.poses]), odometry.stamps)
            unused = [*odometry.flaws, *np.flatnonzero(again).tolist()]
            self.stamped = clocks.effective(
                odometry.name, odometry.stamps, odometry.receipts, unused,
                wishes.receipt_time, said, skipped,
            )  # fmt: skip
        self.kept = np.zeros(0, dtype=np.int64)  # rows, in file order

    def settle(self, keep: NDArray[np.bool_], skipped: Counter[str], changed: Counter[str]) -> None:
        """Drop spikes and carry resets on, now that the drive is known."""
        rows = np.flatnonzero(keep)
        rows = rows[np.argsort(self.stamped.stamps[rows], kind="stable")]
        wild = wheels.spikes(self.stamped.stamps[rows], self.poses[rows])
        if wild.any():
            skipped["odometry where no robot can have driven"] += int(wild.sum())
        rows = rows[~wild]
        poses = self.poses.copy()
        poses[rows] = wheels.carried_on(self.stamped.stamps[rows], self.poses[rows], changed)
        self.poses, self.kept = poses, np.sort(rows)


def _count_disorder(
    scans: NDArray[np.int64], odometry: NDArray[np.int64], changed: Counter[str]
) -> None:
    for own in (odometry, scans):
        if backwards := int(np.count_nonzero(np.diff(own) < 0)):
            changed["stamps that ran backwards, put in order"] += backwards
    if again := len(scans) - len(np.unique(scans)):
        changed["scans with the stamp of another, kept"] += again


def _ordered(choice: Choice, scan_stamps: NDArray[np.int64], rows: _Wheels) -> Plan:
    """Rank all messages by stamp, odometry before a scan."""
    scan_rows = np.flatnonzero(scan_stamps >= 0)
    wheel_stamps = rows.stamped.stamps[rows.kept]
    stamps = np.concatenate([wheel_stamps, scan_stamps[scan_rows]])
    is_scan = np.arange(len(stamps)) >= len(wheel_stamps)
    ranks = np.empty(len(stamps), dtype=np.int64)
    ranks[np.lexsort((is_scan, stamps))] = np.arange(len(stamps))
    scan_ranks = np.full(len(scan_stamps), DROPPED, dtype=np.int64)
    scan_ranks[scan_rows] = ranks[len(wheel_stamps) :]
    places = ranks[: len(wheel_stamps)].tolist()
    odometry = [
        (rank, receipt, WheelOdometry(stamp, *pose))
        for rank, receipt, stamp, pose in zip(
            places, rows.receipts[rows.kept].tolist(), wheel_stamps.tolist(),
            rows.poses[rows.kept].tolist(), strict=True,
        )
    ]  # fmt: skip
    return Plan(choice, scan_stamps, scan_ranks, sorted(odometry, key=lambda item: item[0]))
