"""Whether the clocks that stamped laser and robot agree."""

from __future__ import annotations

from collections.abc import Iterator

from slam.logs.findings import Finding
from slam.logs.sampled import Sampled

APART_S = 2.0  # clocks of laser and robot farther apart give no odometry at a scan
NOTABLE_APART_S = 0.25  # at 0.5 m/s a scan is taken 12 cm from where it was
_SAMPLES = 256  # enough for a median


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
            receipt, stamp = self._odometry
            self._apart.add(((stamp - stamp_ns) - (receipt - receipt_ns)) * 1e-9)

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd; nothing where times of receipt were not logged."""
        apart = self._apart.median
        if not abs(apart) > NOTABLE_APART_S:
            return
        yield Finding(
            "error" if abs(apart) > APART_S else "warning", "clocks-apart", "/odom",
            f"clocks of /scan and /odom differ by {abs(apart):.4g} s, judged by the times of "
            "receipt: set them, or import the recording with --use-receipt-time",
        )  # fmt: skip
