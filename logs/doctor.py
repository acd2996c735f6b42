"""A log's health, as far as it shows without running SLAM: one pass, bounded memory.

What replay makes of odd logs, and the code of the finding that says so:

- two lasers: only `/scan` is read, a laser on another topic is named (`another-laser`); two
  on one channel, or two mounts, cannot be told apart and are errors (`two-lasers`,
  `mount-changes`);
- a gap of minutes (`scan-gap`, `odom-gap`): read as it is, what comes after hangs on odometry;
- stamps from 1970: a clock that was never set does no harm (`clock-unset`), one that was set
  during the recording leaves a gap of decades (`clock-set-late`);
- stamps that run backwards or repeat (`stamps-backwards`, `stamps-duplicate`): the log keeps
  them in file order, replay skips such scans and counts them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from slam.logs.check_clocks import ClocksCheck
from slam.logs.check_motion import MountCheck, OdometryCheck
from slam.logs.check_scans import ScanCheck
from slam.logs.check_time import ReceiptCheck, StampCheck
from slam.logs.errors import shown
from slam.logs.findings import SEVERITIES, Finding, Severity
from slam.logs.info import recording_losses
from slam.logs.mcap_open import open_log
from slam.logs.mcap_read import Log
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.logs.schemas import CHANNELS, topic_of

_TOPICS = ("/scan", "/odom", "/tf", "/truth")
_STAMPED = ("/scan", "/odom")


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Everything that was found, worst first."""

    path: str
    findings: tuple[Finding, ...]
    drift_ppm: dict[str, float]  # per topic: the receiving clock against the device's; or nan

    @property
    def worst(self) -> Severity | None:
        """The worst severity, None for a log without findings."""
        return self.findings[0].severity if self.findings else None

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values for `json.dumps`; nan becomes None."""
        plain = asdict(self) | {"worst": self.worst}
        plain["drift_ppm"] = {
            topic: drift if math.isfinite(drift) else None
            for topic, drift in self.drift_ppm.items()
        }
        return plain


class Check(Protocol):
    """A check that needs more than this package has."""

    def feed(self, message: Message) -> None:
        """Take in one message."""
        ...

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd."""
        ...


class Examination:
    """Takes in messages in file order; `findings` at the end says what is odd."""

    def __init__(self) -> None:
        self._stamps = {topic: StampCheck(topic) for topic in _STAMPED}
        self._receipts = {topic: ReceiptCheck(topic) for topic in _STAMPED}
        self._scans, self._odometry, self._extrinsics = ScanCheck(), OdometryCheck(), MountCheck()
        self._clocks = ClocksCheck()

    def feed(self, receipt_ns: int, message: Message) -> None:
        """Take in one message and its time of receipt."""
        topic = topic_of(message)
        if topic in self._stamps:
            self._stamps[topic].feed(message.stamp_ns)
            self._receipts[topic].feed(receipt_ns, message.stamp_ns)
        if isinstance(message, LaserScan):
            self._scans.feed(message)
            self._odometry.feed_scan(message.stamp_ns)
            self._clocks.feed_scan(receipt_ns, message.stamp_ns)
        elif isinstance(message, WheelOdometry):
            self._odometry.feed(message)
            self._scans.feed_motion(self._odometry.moved())
            self._clocks.feed_odometry(receipt_ns, message.stamp_ns)
        elif isinstance(message, LaserExtrinsics):
            self._extrinsics.feed(message)

    def findings(self) -> Iterator[Finding]:
        """Yield what is odd, check after check."""
        for check in (self._scans, self._odometry, self._extrinsics, self._clocks):
            yield from check.findings()
        for topic in _STAMPED:
            if not self._stamps[topic].empty:
                yield from self._stamps[topic].findings()
                yield from self._receipts[topic].findings()

    def drift_ppm(self) -> dict[str, float]:
        """Return each device clock's drift against the time of receipt; nan if unknown."""
        return {topic: check.drift_ppm() for topic, check in self._receipts.items()}


def diagnose(path: Path | str, more: Sequence[Check] = ()) -> Diagnosis:
    """Read a log once and return what is odd about it, by our own checks and `more`.

    Raises:
        LogError: if it cannot be opened as one of our logs.
    """
    examination = Examination()
    with open_log(path) as log:
        for receipt_ns, message in log.receipts(_TOPICS):
            examination.feed(receipt_ns, message)
            for check in more:
                check.feed(message)
        findings = [*examination.findings(), *_other_lasers(log), *_losses(log)]
    for check in more:
        findings += check.findings()
    findings.sort(key=lambda finding: SEVERITIES.index(finding.severity))
    return Diagnosis(str(path), tuple(findings), examination.drift_ppm())


def _other_lasers(log: Log) -> Iterator[Finding]:
    for topic, schema in log.channels().items():
        if schema.endswith("LaserScan") and topic not in CHANNELS:
            yield Finding(
                "warning", "another-laser", shown(topic),
                f"a second laser on {shown(topic)}: replay uses /scan alone",
            )  # fmt: skip


def _losses(log: Log) -> Iterator[Finding]:
    for cause, count in recording_losses(log.metadata()).items():
        text = f"lost while recording: {count}, {shown(cause)}"
        yield Finding("error", "lost-recording", "", text, count)
    for cause, count in log.skipped.items():
        yield Finding("error", "lost-reading", "", f"{count} x {shown(cause)}", count)
