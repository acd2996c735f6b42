"""What an operator wants to know while the robot drives, and how it is put into one line."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

STALE_S = 1.0  # s; both devices send ten times a second or more: data that old are no live data
GOOD_LINKS = ("connected", "resumed")
# Counters of the decoders that tell of activity rather than of loss.
_NO_LOSS = (
    "scans", "reports", "skipped_bytes", "moved_stamps", "clock_restarts", "distrusted_syncs",
    "foreign_scans", "self_checks",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Status:
    """How an online run stands."""

    seconds: float  # since it began
    links: Mapping[str, str]  # device to the kind of its last event; "waiting" before the first
    scan_hz: float  # of scans that came in since the last status
    age_s: float  # since the newest scan that is used came in; since the beginning before the first
    waiting: int  # messages recorded and not yet used
    keyframes: int
    t_pe: float  # at the last keyframe; nan for other methods
    sigmas: tuple[float, ...]  # x, y (m), theta (rad) of the last match; empty if none
    lost: Mapping[str, int]  # by cause
    news: tuple[str, ...] = ()  # what has happened to the devices since the last status
    # What is wrong with a device whose link is not good, and what is being tried.
    reasons: Mapping[str, str] = field(default_factory=dict)
    robot: Mapping[str, str] = field(default_factory=dict)  # battery, motors, STOP button ...
    warnings: tuple[str, ...] = ()  # what of that needs a hand

    @property
    def alarm(self) -> str:
        """Why what is shown is not live, in words; empty if it is."""
        if self.links and all(kind == "closed" for kind in self.links.values()):
            return ""
        bad = [
            f"{device} {kind}: {self.reasons[device]}" if device in self.reasons
            else f"{device} {kind}"
            for device, kind in sorted(self.links.items()) if kind not in GOOD_LINKS
        ]  # fmt: skip
        if not bad and self.age_s > STALE_S:
            bad = [
                f"no scan for {self.age_s:.1f} s",
                *(f"{device}: {text}" for device, text in sorted(self.reasons.items())),
            ]
        return "; ".join(bad)

    def line(self) -> str:
        """All of it on one line."""
        words = [f"{self.seconds:.0f} s", f"{self.scan_hz:.1f} scans/s"]
        words += [
            f"{device} {kind}" for device, kind in sorted(self.links.items())
            if kind not in GOOD_LINKS
        ]  # fmt: skip
        old = self.age_s > STALE_S
        words.append(f"age {self.age_s:.1f} s" if old else f"age {1e3 * self.age_s:.0f} ms")
        words += self.warnings
        if self.robot.get("motors") == "off":
            words.append("motors off")
        if self.waiting > 1:
            words.append(f"{self.waiting} waiting")
        words.append(f"{self.keyframes} keyframes")
        if math.isfinite(self.t_pe):
            words.append(f"T_PE {self.t_pe:.2f}")
        if self.sigmas:
            x, y, theta = self.sigmas
            words.append(f"sigma {1e3 * x:.0f} mm {1e3 * y:.0f} mm {math.degrees(theta):.2f} deg")
        total = sum(self.lost.values())
        causes = ", ".join(f"{n} {cause}" for cause, n in self.lost.items())
        words.append(f"lost {total} ({causes})" if total else "lost 0")
        return ", ".join(words)


def device_losses(device: str, counters: Mapping[str, int]) -> dict[str, int]:
    """Pick what was lost from a decoder's counters, in words."""
    return {
        f"{device}: {name.removeprefix('lost_').replace('_', ' ')}": count
        for name, count in counters.items()
        if count and name not in _NO_LOSS
    }
