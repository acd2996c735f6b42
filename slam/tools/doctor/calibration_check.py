"""Does the drive agree with the calibration that its log states?  In the words of `calibrate`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from slam.evaluation.calibration.intervals import IntervalCollector
from slam.evaluation.calibration.result import calibrate
from slam.evaluation.calibration.unknowns import Found
from slam.logs.findings import Finding, Severity
from slam.logs.mcap_open import open_log
from slam.logs.messages import Message
from slam.mapping.calibration import CalibrationConfig

MOST_INTERVALS = 400  # a drive of some five minutes: more would take long, and say no more
SURE = 5.0  # sigmas
MATERIAL: Mapping[str, float] = MappingProxyType(
    {
        "laser_x": 0.03, "laser_y": 0.03,  # m: a turn on the spot moves the map by as much
        "laser_yaw_deg": 1.0,  # 10 m are bent by 17 cm
        # The mapping trusts odometry to 5 % per metre and 10 % per radian.
        "translation_scale": 0.05, "rotation_scale": 0.10, "curvature": 0.03,
        "time_offset_s": 0.05,  # as far as it lets odometry and scan disagree
    }
)  # fmt: skip
LATE_S = 0.1  # a time offset over which turns look like faults of the wheels
_MOUNT = "/tf"


class CalibrationCheck:
    """Messages in file order; `findings` calibrates from the first minutes of driving."""

    def __init__(self, known: CalibrationConfig | None = None) -> None:
        """`known` is what counts for true of the robot, besides the mount in its log."""
        self._known = known or CalibrationConfig()
        self._collector = IntervalCollector(known=self._known, most=MOST_INTERVALS)

    def feed(self, message: Message) -> None:
        """Take in one message."""
        self._collector.feed(message)

    def findings(self) -> Iterator[Finding]:
        """Yield each disagreement that is sure and that matters."""
        for one in calibrate([self._collector.data()], known=self._known).found:
            if one.refused or one.stated is None:
                continue
            if one.off > SURE and abs(one.value - one.stated) > MATERIAL[one.name]:
                yield _finding(one)


def _finding(one: Found) -> Finding:
    late = one.name == "time_offset_s" and abs(one.value) > LATE_S
    severity: Severity = "warning" if late else "note"
    unit = f" {one.unit}" if one.unit else ""
    return Finding(
        severity, f"calibration-{one.name.replace('_', '-')}",
        _MOUNT if one.name.startswith("laser") else "/odom",
        f"the drive says {one.name} = {one.value:.4g} +- {one.sigma:.2g}{unit}, the log "
        f"{one.stated:.4g}: see `slam calibrate`",
    )  # fmt: skip


def known_calibration(path: Path) -> CalibrationConfig | None:
    """The calibration that a robot had while it recorded; None if none is noted.

    Raises:
        LogError: the log cannot be read.
    """
    with open_log(path) as log:
        for attachment in log.attachments():
            if attachment.name == "robot.json":
                try:
                    return CalibrationConfig.model_validate(
                        json.loads(attachment.data).get("calibration", {})
                    )
                except (ValueError, AttributeError):  # somebody else's attachment of that name
                    return None
    return None
