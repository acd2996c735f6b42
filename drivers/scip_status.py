"""What the status codes of SCIP 2.x mean, in words (docs/devices.md, section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

# Section 4.1; a code without a name here is an error all the same.
_GENERIC: Mapping[str, str] = MappingProxyType(
    {
        "00": "done",
        "0A": "internal error",
        "0B": "buffer full, or the same command is still in work",
        "0C": "too few parameters",
        "0D": "command too long, or unknown",
        "0E": "unknown command",
        "0F": "command not supported, or too few parameters",
        "0G": "user string too long",
        "0H": "user string has forbidden characters",
        "0I": "firmware update in progress",
        "0L": "abnormal state",
        "0M": "unstable state",
        "10": "denied in this state (is the laser off, or scanning?)",
    }
)
_SCAN_NAMES = {
    "01": "start step is not a number",
    "02": "end step is not a number",
    "03": "cluster is not a number",
    "04": "end step out of range",
    "05": "end step before start step",
    "06": "interval is not a number",
    "07": "number of scans is not a number",
    "98": "sensor is sound again after its check",
    "99": "scan",
}
_NAMES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "BM": {"01": "laser fault", "02": "laser is on already"},
        "TM": {
            "01": "no such mode",
            "02": "in clock mode already",
            "03": "out of clock mode already",
            "04": "not in clock mode",
        },
        "SS": {"01": "no number", "02": "no such speed", "03": "set already", "04": "cannot"},
        "CR": {"01": "no number", "02": "no such speed", "03": "set already", "04": "cannot"},
        "HS": {"01": "no number", "02": "set already", "03": "cannot"},
        "RB": {"01": "reboot must be asked for twice"},
    }
)


def status_name(symbol: str, status: str) -> str:
    """Name the status of a command (section 4.1)."""
    names = _SCAN_NAMES if symbol[:1] in ("G", "M") else _NAMES.get(symbol, {})
    if symbol[:1] in ("G", "M") and status.isdigit():
        if 21 <= int(status) <= 49:
            return f"sensor has stopped to check itself ({status})"
        if 50 <= int(status) <= 97:
            return f"hardware fault {status}"
    return names.get(status) or _GENERIC.get(status) or f"unknown status {status}"
