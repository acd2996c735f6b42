"""What an importer returns: messages in stamp order, and what had to be done to them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

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

    odometry: WheelOdometry
    scan: LaserScan | None = None


def in_stamp_order(readings: Iterable[Reading], changed: Counter[str]) -> list[Reading]:
    """Return the readings ordered by stamp, those of one stamp in file order.

    Counts the steps that run backwards in the file, and stamps that occur again.
    """
    listed = list(readings)
    stamps = [reading.odometry.stamp_ns for reading in listed]
    backwards = sum(b < a for a, b in pairwise(stamps))
    if backwards:
        changed["stamps that ran backwards, put in order"] += backwards
    scan_stamps = [r.odometry.stamp_ns for r in listed if r.scan is not None]
    if again := len(scan_stamps) - len(set(scan_stamps)):
        changed["scans with the stamp of another, kept"] += again
    return sorted(listed, key=lambda reading: reading.odometry.stamp_ns)


def as_messages(
    readings: Sequence[Reading], base_T_laser: tuple[float, float, float]
) -> list[SensorMessage]:
    """Return the mount, then each reading's odometry and scan."""
    if not readings:
        return []
    messages: list[SensorMessage] = [LaserExtrinsics(readings[0].odometry.stamp_ns, *base_T_laser)]
    for reading in readings:
        messages.append(reading.odometry)
        if reading.scan is not None:
            messages.append(reading.scan)
    return messages
