"""What a check has to say about a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
"""Worst first: an error makes a map unlikely, a warning costs accuracy, a note is to know."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing worth knowing about a log, counted over all of it."""

    severity: Severity
    code: str  # stable, for programs: "scan-gap", "clock-drift", ...
    topic: str
    text: str  # what, how much, and what it means
    count: int = 1
    at_ns: int = 0  # stamp of the first (or worst) case, 0 where it concerns the whole log


def seconds(value: float) -> str:
    """Return a duration in words a person can judge."""
    if value >= 120.0:
        return f"{value / 60.0:.1f} min"
    return f"{value:.3g} s"
