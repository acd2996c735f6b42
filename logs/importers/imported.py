"""What an importer returns: messages in stamp order, and what had to be done to them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from slam.logs.importers.bag.clocks import Stamped
from slam.logs.importers.drives import pick_drive
from slam.logs.importers.wishes import Wishes, check_span
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, WheelOdometry


@dataclass(frozen=True, eq=False, slots=True)
class ImportedLog:
    """A foreign log.  Each scan follows the odometry of its stamp; the mount comes first."""

    kind: str  # "CARMEN", "BreezySLAM", ...
    messages: Sequence[SensorMessage]
    skipped: Counter[str] = field(default_factory=Counter)  # lost: unusable lines, per cause
    changed: Counter[str] = field(default_factory=Counter)  # kept, but reordered or repaired
    ignored: Counter[str] = field(default_factory=Counter)  # sound, but no use for them here
    receipts_ns: Sequence[int] = ()  # one a message, where the log has times of receipt
    notes: list[str] = field(default_factory=list)  # what was chosen
    warnings: list[str] = field(default_factory=list)  # what of it was a guess

    def received(self) -> Iterator[tuple[SensorMessage, int | None]]:
        """Yield each message with its time of receipt, None where that is unknown."""
        if self.receipts_ns:
            yield from zip(self.messages, self.receipts_ns, strict=True)
        else:
            yield from ((message, None) for message in self.messages)


@dataclass(frozen=True, eq=False, slots=True)
class StreamedLog:
    """A foreign log too large to hold: like `ImportedLog`, but read anew each time it is asked."""

    kind: str
    read: Callable[[], Iterator[tuple[SensorMessage, int]]]
    skipped: Counter[str]
    changed: Counter[str]
    ignored: Counter[str]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def received(self) -> Iterator[tuple[SensorMessage, int]]:
        """Yield each message with its time of receipt."""
        return self.read()


@dataclass(frozen=True, eq=False, slots=True)
class Reading:
    """One line of a log: a scan, where the odometry put the robot then, or both."""

    odometry: WheelOdometry | None = None
    scan: LaserScan | None = None

    @property
    def stamp_ns(self) -> int:
        """When it was measured; scan and odometry of one reading have the same stamp."""
        message = self.odometry or self.scan
        assert message is not None
        return message.stamp_ns


_NO_WISHES = Wishes()


def in_stamp_order(
    readings: Iterable[Reading],
    changed: Counter[str],
    skipped: Counter[str] | None = None,
    wishes: Wishes = _NO_WISHES,
) -> list[Reading]:
    """Return the readings of one drive ordered by stamp, those of one stamp in file order.

    Counts the steps that run backwards in the file, and stamps that occur again.

    Raises:
        LogError: there are several drives (see `drives`) and none is asked for.
    """
    listed = list(readings)
    check_span(wishes)
    if listed:
        stamps = np.array([reading.stamp_ns for reading in listed], dtype=np.int64)
        whole = Stamped(stamps, np.ones(len(listed), dtype=np.bool_))
        lost: Counter[str] = Counter() if skipped is None else skipped
        (keep,) = pick_drive([("scans", whole)], wishes, lost, changed)
        listed = [listed[row] for row in np.flatnonzero(keep).tolist()]
    backwards = sum(b.stamp_ns < a.stamp_ns for a, b in pairwise(listed))
    if backwards:
        changed["stamps that ran backwards, put in order"] += backwards
    scan_stamps = [r.stamp_ns for r in listed if r.scan is not None]
    if again := len(scan_stamps) - len(set(scan_stamps)):
        changed["scans with the stamp of another, kept"] += again
    # Of one stamp, odometry that comes in a line of its own goes before the scan.
    return sorted(listed, key=lambda reading: (reading.stamp_ns, reading.odometry is None))


def as_messages(
    readings: Sequence[Reading],
    base_T_laser: tuple[float, float, float],
    wishes: Wishes = _NO_WISHES,
) -> list[SensorMessage]:
    """Return the mount, the one asked for if any, then each reading's odometry and scan."""
    if not readings:
        return []
    mount = wishes.mount or base_T_laser
    messages: list[SensorMessage] = [LaserExtrinsics(readings[0].stamp_ns, *mount)]
    for reading in readings:
        messages += [m for m in (reading.odometry, reading.scan) if m is not None]
    return messages
