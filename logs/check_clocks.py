"""Whether the clocks that stamped laser and robot agree."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from slam.logs.errors import LogError
from slam.logs.findings import Finding
from slam.logs.messages import LaserScan, Message, WheelOdometry
from slam.logs.sampled import Sampled

APART_S = 2.0  # clocks of laser and robot farther apart give no odometry at a scan
NOTABLE_APART_S = 0.25  # at 0.5 m/s a scan is taken 12 cm from where it was
_SAMPLES = 256  # enough for a median
_MENDS = "set them, or import the recording with --use-receipt-time"


class ClocksCheck:
    """Whether laser and robot were stamped by clocks that agree, judged by times of receipt."""

    def __init__(self) -> None:
        self._apart = Sampled(_SAMPLES)  # s by which the odometry's clock is ahead
        self._odometry: tuple[int, int] | None = None  # receipt, stamp of the last

    def feed_odometry(self, receipt_ns: int, stamp_ns: int) -> None:
        """Take in one odometry message's times."""
        self._odometry = receipt_ns, stamp_ns

    def feed_scan(self, receipt_ns: int, stamp_ns: int) -> None:
        """Take in one scan's times."""
        if self._odometry is not None:
            self._apart.add(_ahead_s(self._odometry, (receipt_ns, stamp_ns)))

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd; nothing where times of receipt were not logged."""
        apart = self._apart.median
        if not abs(apart) > NOTABLE_APART_S:
            return
        yield Finding(
            "error" if abs(apart) > APART_S else "warning", "clocks-apart", "/odom",
            f"{_difference(apart)}: {_MENDS}",
        )  # fmt: skip


def refuse_clocks_apart(name: str, receipts: Iterable[tuple[int, Message]]) -> None:
    """Refuse a log whose scans would all be mapped with an odometry that seems to stand still.

    Args:
        name: of the log.
        receipts: its scans and odometry with their times of receipt; not read farther than needed.

    Raises:
        LogError: laser and robot were stamped by clocks that differ by more than APART_S.
    """
    apart = Sampled(_SAMPLES)
    odometry: tuple[int, int] | None = None
    compared = 0
    for receipt_ns, message in receipts:
        if isinstance(message, WheelOdometry):
            odometry = receipt_ns, message.stamp_ns
        elif isinstance(message, LaserScan) and odometry is not None:
            apart.add(_ahead_s(odometry, (receipt_ns, message.stamp_ns)))
            compared += 1
            if compared == _SAMPLES:
                break
    if abs(apart.median) > APART_S:
        raise LogError(f"{name}: {_difference(apart.median)}: {_MENDS}")


def _ahead_s(odometry: tuple[int, int], scan: tuple[int, int]) -> float:
    """By how much the odometry's clock is ahead of the scan's, from receipt and stamp of each."""
    return ((odometry[1] - scan[1]) - (odometry[0] - scan[0])) * 1e-9


def _difference(apart_s: float) -> str:
    return (
        f"clocks of /scan and /odom differ by {abs(apart_s):.4g} s, judged by the times of receipt"
    )
