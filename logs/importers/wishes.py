"""What a user may say about a recording that it does not say itself, or says wrongly."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slam.logs.errors import LogError

MOUNT_FORM = "x,y,theta in m, m and rad (or deg: `0.2,0,90deg`)"


@dataclass(frozen=True, kw_only=True, slots=True)
class Wishes:
    """Answers given beforehand; empty or None where the recording shall decide."""

    scan: str = ""  # topic
    odometry: str = ""  # topic, or two frames `odom>base_link` of /tf
    base: str = ""  # frame
    mount: tuple[float, float, float] | None = None  # base_T_laser: m, m, rad
    receipt_time: bool = False  # times of receipt stand in for stamps
    start_s: float = 0.0  # from the first message on
    end_s: float = math.inf
    drive: int = 0  # number of the drive, from 1; 0: there is one alone
    view_deg: float = 0.0  # field of view of FLASER lines, 0 where the beams tell it

    def for_bags_only(self) -> list[str]:
        """Name the options given that only ROS recordings can follow."""
        asked = (
            ("--scan", self.scan), ("--base", self.base),
            ("--odom", self.odometry),
            ("--use-receipt-time", self.receipt_time),
        )  # fmt: skip
        return [option for option, given in asked if given]


def parse_mount(text: str) -> tuple[float, float, float]:
    """Return x, y (m) and theta (rad) of `0.2,0.1,1.0` or `0.2,0.1,57.3deg`.

    Raises:
        ValueError: it is not that.
    """
    fields = text.replace(" ", "").split(",")
    if len(fields) != 3:
        raise ValueError(f"{text!r} is not {MOUNT_FORM}")
    degrees = fields[2].endswith("deg")
    try:
        x, y, theta = (float(field.removesuffix("deg").removesuffix("rad")) for field in fields)
    except ValueError as error:
        raise ValueError(f"{text!r} is not {MOUNT_FORM}") from error
    theta = math.radians(theta) if degrees else theta
    if not math.isfinite(x + y + theta):
        raise ValueError(f"{text!r}: the numbers must be finite")
    if abs(theta) > math.tau:
        raise ValueError(f"{text!r}: theta is more than a turn: write `{fields[2]}deg` for degrees")
    return x, y, theta


def mount_in_words(x: float, y: float, theta: float) -> str:
    """Write a mount as people read it: `(0.20, 0.10, 57.3 deg)`, to the millimetre if need be."""
    return f"({_metres(x)}, {_metres(y)}, {math.degrees(theta) + 0.0:.1f} deg)"


def _metres(value: float) -> str:
    whole = abs(round(value, 2) - value) < 5e-4  # whole centimetres
    return f"{round(value, 2 if whole else 3) + 0.0:.{2 if whole else 3}f}"


def check_span(wishes: Wishes) -> None:
    """Refuse a span of time that holds nothing.

    Raises:
        LogError: it ends before it starts.
    """
    if not 0 <= wishes.start_s < wishes.end_s:
        raise LogError(
            f"--from {wishes.start_s:g} --to {wishes.end_s:g}: a span must start at 0 or later and "
            "end after that"
        )
