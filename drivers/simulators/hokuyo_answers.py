"""What a simulated Hokuyo says of itself, and why it refuses (sections: docs/devices.md)."""

from __future__ import annotations

import re

from slam.drivers.scip_protocol import encode_number, information_line
from slam.drivers.scip_scan import SCAN_SYMBOLS, decode_request
from slam.drivers.simulators.hokuyo_models import HokuyoModel

_NOTE_MOST = 16  # characters of a user string (section 4)
_FIELDS = ((2, 6, "01"), (6, 10, "02"), (10, 12, "03"), (12, 13, "06"), (13, 15, "07"))


def version(model: HokuyoModel, serial: str, damaged: bool) -> list[bytes]:
    """Return the lines of VV; `damaged` as users have seen them (section 6)."""
    lines = [
        information_line("VEND", "Hokuyo Automatic Co.,Ltd."),
        information_line("PROD", model.product),
        information_line("FIRM", model.firmware),
        information_line("PROT", model.protocol),
        information_line("SERI", serial),
    ]
    if damaged:
        lines[1:2] = [b"stray", lines[1][:-1] + b"!"]
    return lines


def old_version(model: HokuyoModel, serial: str) -> bytes:
    """Return the whole answer to V in SCIP 1.1: the lines of VV without sums, status 0."""
    lines = [line[:-2] for line in version(model, serial, damaged=False)]
    return b"\n".join([b"V", b"0", *lines]) + b"\n\n"


def parameters(model: HokuyoModel) -> list[bytes]:
    """Return the lines of PP."""
    p = model.parameters
    values: list[tuple[str, object]] = [
        ("MODL", p.model),
        ("DMIN", p.range_min_mm),
        ("DMAX", p.range_max_mm),
        ("ARES", p.steps_per_turn),
        ("AMIN", p.first_step),
        ("AMAX", p.last_step),
        ("AFRT", p.front_step),
        ("SCAN", p.rpm),
    ]
    if model.ethernet:
        values.insert(3, ("PROT", model.protocol))
    return [information_line(key, str(value)) for key, value in values]


def information(model: HokuyoModel, count: int, lit: bool, sound: bool) -> list[bytes]:
    """Return the lines of II; `count` is the sensor's clock."""
    p = model.parameters
    clock = encode_number(count, 4).decode() if model.ethernet else f"{count:06X}"
    return [
        information_line("MODL", p.model),
        information_line("LASR", "ON" if lit else "OFF"),
        information_line("SCSP", f"Initial({p.rpm}[rpm])<-Default setting by user"),
        information_line("MESM", "CLASSIC"),
        information_line("SBPS", model.line),
        information_line("TIME", clock),
        information_line("STAT", model.sound if sound else "Laser malfunction. (50)"),
    ]


def no_command(line: bytes) -> str:
    """Return the status of a line that cannot be read (section 4.1): what is wrong with it?"""
    command, semicolon, note = line.partition(b";")
    symbol = command[:2].decode("latin-1")
    if semicolon and re.fullmatch(rb"%?[A-Z]{2}[0-9]*", command):
        return "0G" if len(note) > _NOTE_MOST else "0H"
    if symbol in SCAN_SYMBOLS:
        return _not_numeric(command) or "0E"
    return "0E"


def _not_numeric(command: bytes) -> str:
    """Return which parameter of a scan command is no number (section 4.2), "" if none."""
    for begin, end, status in _FIELDS:
        field = command[begin:end]
        if field and not field.isdigit():
            return status
    return ""


def no_scan(line: bytes, points: tuple[int, int]) -> str:
    """Return the status with which a scan command is refused, "" if it is not (section 4.2).

    `points` are the first and the last step that the sensor answers for.
    """
    request = decode_request(line)
    if request is None:
        command = line.partition(b";")[0]
        return "0C" if len(command) < (15 if command[:1] == b"M" else 12) else "0D"
    if request.end > points[1]:
        return "04"
    if request.start < points[0]:
        return "01"
    return "05" if request.end < request.start else ""
