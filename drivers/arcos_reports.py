"""What a Pioneer reports: standard packet, configuration, encoders, identity; both directions.

Sections are those of DEVICES.md.  Units are the robot's own; `drivers.pioneer_decoder`
turns them into metres and radians.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

STANDING, MOVING = 0x32, 0x33  # types of the standard packet; simulators may never send 0x33
CONFIG, ENCODER, IO, GYRO = 0x20, 0x90, 0xF0, 0x98
STANDARD = (STANDING, MOVING)

# Bits of StandardReport.flags (section 2)
MOTORS_ENABLED, STOP_BUTTON = 1 << 0, 1 << 5
_LEFT_STALL, _RIGHT_STALL = 1 << 0, 1 << 8

_FIXED = struct.Struct("<hhhhhBHhHBB")  # XPOS to the number of sonar readings
_FIXED_FIELDS = (
    *("x", "y", "theta", "left_vel", "right_vel", "battery", "stall_bumpers"),
    *("control", "flags", "compass"),
)
_SONAR = struct.Struct("<BH")
# Everything behind the sonar readings may be cut off (section 2).
_TAIL = (
    ("grip_state", "<B"),
    ("analog_port", "<B"),
    ("analog", "<B"),
    ("digital_in", "<B"),
    ("digital_out", "<B"),
    ("battery_x10", "<H"),
    ("charge_state", "<b"),
    ("rot_vel", "<h"),
    ("fault_flags", "<H"),
    ("lat_vel", "<h"),
    ("temperature", "<b"),
    ("charge_percent", "<B"),
)


class Identity(NamedTuple):
    """How the robot answers SYNC2 (section 1.1)."""

    name: str
    robot_class: str
    subclass: str  # selects the conversion factors


@dataclass(frozen=True, slots=True)
class StandardReport:
    """The standard server information packet (section 2); None where firmware left a field out."""

    x: int = 0  # signed 16 bits, in DistConvFactor mm; wraps
    y: int = 0
    theta: int = 0  # in AngleConvFactor rad, 4096 a turn, anticlockwise
    left_vel: int = 0  # mm/s
    right_vel: int = 0  # mm/s
    battery: int = 0  # 0.1 V
    stall_bumpers: int = 0  # bit 0 left stall, 1-7 rear bumpers, 8 right stall, 9-15 front
    control: int = 0  # heading setpoint
    flags: int = 0
    compass: int = 0  # 2 degrees
    sonar: tuple[tuple[int, int], ...] = ()  # (number, range in RangeConvFactor mm)
    moving: bool = False
    grip_state: int | None = None
    analog_port: int | None = None
    analog: int | None = None
    digital_in: int | None = None
    digital_out: int | None = None
    battery_x10: int | None = None  # 0.1 V
    charge_state: int | None = None
    rot_vel: int | None = None  # 0.1 deg/s
    fault_flags: int | None = None
    lat_vel: int | None = None  # mm/s
    temperature: int | None = None  # deg C, -128 if not measured
    charge_percent: int | None = None

    @property
    def motors_enabled(self) -> bool:
        """Whether the wheels are powered."""
        return bool(self.flags & MOTORS_ENABLED)

    @property
    def stalled(self) -> tuple[bool, bool]:
        """Whether the left and the right wheel stall."""
        return bool(self.stall_bumpers & _LEFT_STALL), bool(self.stall_bumpers & _RIGHT_STALL)

    @property
    def bumpers(self) -> tuple[int, int]:
        """Bit masks of the front and rear bumpers that touch something."""
        return self.stall_bumpers >> 9 & 0x7F, self.stall_bumpers >> 1 & 0x7F

    @property
    def volts(self) -> float:
        """Battery voltage, from the wider field where there is one."""
        return (self.battery if self.battery_x10 is None else self.battery_x10) / 10.0


@dataclass(frozen=True, slots=True)
class ConfigReport:
    """The part of a CONFIGpac that matters here (section 2.2); the rest is skipped."""

    robot_class: str
    subclass: str
    serial: str
    name: str
    rot_vel_top: int  # deg/s
    trans_vel_top: int  # mm/s
    sip_cycle: int  # ms
    host_baud: int  # code of HOSTBAUD
    watchdog: int  # ms
    auto_baud: int  # 2: HOSTBAUD may be used
    rev_count: int = 0
    ticks_mm: int = 0


class EncoderReport(NamedTuple):
    """Accumulated encoder counts (section 2.2)."""

    left: int
    right: int


def decode_identity(payload: bytes) -> Identity | None:
    """Return who answered SYNC2, None if the three strings are not there."""
    parts = payload[1:].split(b"\0")
    if len(parts) < 4:
        return None
    name, robot_class, subclass = (part.decode("latin-1") for part in parts[:3])
    return Identity(name, robot_class, subclass)


def encode_identity(identity: Identity) -> bytes:
    """Return the payload of the answer to SYNC2."""
    return b"\x02" + b"".join(part.encode("latin-1") + b"\0" for part in identity)


def decode_standard(payload: bytes) -> StandardReport | None:
    """Return the standard report, None if even its fixed part is cut short.

    With sonar off, AMRISim still counts 16 readings but sends none: a number that does not
    fit costs the sonar and what stands behind it, not the pose.
    """
    body = payload[1:]
    if payload[0] not in STANDARD or len(body) < _FIXED.size:
        return None
    fixed = dict(zip(_FIXED_FIELDS, _FIXED.unpack_from(body), strict=False))
    count, moving = body[_FIXED.size - 1], payload[0] == MOVING
    at = _FIXED.size + count * _SONAR.size
    if len(body) < at:
        return StandardReport(**fixed, moving=moving)
    sonar = tuple(_SONAR.iter_unpack(body[_FIXED.size : at]))
    tail: dict[str, Any] = {}
    for name, form in _TAIL:
        if len(body) < at + struct.calcsize(form):
            break
        (tail[name],) = struct.unpack_from(form, body, at)
        at += struct.calcsize(form)
    return StandardReport(**fixed, sonar=sonar, moving=moving, **tail)


def encode_standard(report: StandardReport) -> bytes:
    """Return the payload of a standard report; it ends with the first field that is None."""
    numbers = (
        *(_signed16(value) for value in (report.x, report.y, report.theta)),
        report.left_vel,
        report.right_vel,
        report.battery,
        report.stall_bumpers,
        _signed16(report.control),
        report.flags,
        report.compass,
        len(report.sonar),
    )
    body = _FIXED.pack(*numbers) + b"".join(_SONAR.pack(*reading) for reading in report.sonar)
    for name, form in _TAIL:
        value = getattr(report, name)
        if value is None:
            break
        body += struct.pack(form, value)
    return bytes([MOVING if report.moving else STANDING]) + body


def _signed16(value: int) -> int:
    return (value + 0x8000) % 0x10000 - 0x8000


def decode_encoders(payload: bytes) -> EncoderReport | None:
    """Return the encoder counts, None if they are not complete."""
    if payload[0] != ENCODER or len(payload) < 9:
        return None
    return EncoderReport(*struct.unpack_from("<ii", payload, 1))


def encode_encoders(report: EncoderReport) -> bytes:
    """Return the payload of an ENCODERpac."""
    return bytes([ENCODER]) + struct.pack("<ii", *report)


# CONFIGpac between its strings (section 2.2): 4mots, five tops; then cycle to ticks_mm.
_TOPS = struct.Struct("<B5H")
_BODY = struct.Struct("<3B2HB3HB16H6Bh2B2H")
_SIP_CYCLE, _HOST_BAUD, _REV_COUNT, _WATCHDOG, _AUTO_BAUD, _TICKS = 0, 1, 7, 8, 30, 35


def decode_config(payload: bytes) -> ConfigReport | None:
    """Return the configuration, None if the packet is not one or is cut short."""
    parts = payload[1:].split(b"\0", 3)
    if payload[0] != CONFIG or len(parts) < 4 or len(parts[3]) < _TOPS.size:
        return None
    tops = _TOPS.unpack_from(parts[3])
    name, end, rest = parts[3][_TOPS.size :].partition(b"\0")
    if not end or len(rest) < _BODY.size:
        return None
    body = _BODY.unpack_from(rest)
    robot_class, subclass, serial = (part.decode("latin-1") for part in parts[:3])
    return ConfigReport(
        robot_class=robot_class,
        subclass=subclass,
        serial=serial,
        name=name.decode("latin-1"),
        rot_vel_top=tops[1],
        trans_vel_top=tops[2],
        sip_cycle=body[_SIP_CYCLE],
        host_baud=body[_HOST_BAUD],
        watchdog=body[_WATCHDOG],
        auto_baud=body[_AUTO_BAUD],
        rev_count=body[_REV_COUNT],
        ticks_mm=body[_TICKS],
    )


def encode_config(report: ConfigReport) -> bytes:
    """Return the payload of a CONFIGpac; fields that `ConfigReport` leaves out are zero."""
    body = [0] * len(_BODY.unpack(bytes(_BODY.size)))
    body[_SIP_CYCLE], body[_HOST_BAUD] = report.sip_cycle, report.host_baud
    body[_REV_COUNT], body[_WATCHDOG] = report.rev_count, report.watchdog
    body[_AUTO_BAUD], body[_TICKS] = report.auto_baud, report.ticks_mm
    strings = (report.robot_class, report.subclass, report.serial)
    head = b"".join(text.encode("latin-1") + b"\0" for text in strings)
    tops = _TOPS.pack(0, report.rot_vel_top, report.trans_vel_top, 0, 0, 0)
    name = report.name.encode("latin-1") + b"\0"
    return bytes([CONFIG]) + head + tops + name + _BODY.pack(*body)
