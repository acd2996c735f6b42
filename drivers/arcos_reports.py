"""What a Pioneer reports: standard packet, configuration, encoders, identity; both directions.

Sections are those of docs/devices.md.  Units are the robot's own; `drivers.pioneer_decoder`
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
    def stop_pressed(self) -> bool:
        """Whether somebody holds the robot with its STOP button."""
        return bool(self.flags & STOP_BUTTON)

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
    """The CONFIGpac (section 2.2), in the units of its fields; what firmware leaves out is zero."""

    robot_class: str
    subclass: str
    serial: str
    name: str
    rot_vel_top: int  # deg/s, the tops cannot be set
    trans_vel_top: int  # mm/s
    sip_cycle: int  # ms
    host_baud: int  # code of HOSTBAUD
    watchdog: int  # ms
    auto_baud: int  # 2: HOSTBAUD may be used
    rev_count: int = 0
    ticks_mm: int = 0
    four_motors: int = 0
    rot_acc_top: int = 0  # deg/s^2
    trans_acc_top: int = 0  # mm/s^2
    pwm_max: int = 0
    aux1_baud: int = 0
    gripper: int = 0
    front_sonar: int = 0
    rear_sonar: int = 0
    low_battery: int = 0  # 0.1 V
    p2mpacs: int = 0
    stall_val: int = 0
    stall_count: int = 0
    joy_vel: int = 0
    joy_rot_vel: int = 0
    rot_vel_max: int = 0
    trans_vel_max: int = 0
    rot_acc: int = 0
    rot_decel: int = 0
    rot_kp: int = 0
    rot_kv: int = 0
    rot_ki: int = 0
    trans_acc: int = 0
    trans_decel: int = 0
    trans_kp: int = 0
    trans_kv: int = 0
    trans_ki: int = 0
    front_bumps: int = 0
    rear_bumps: int = 0
    charger: int = 0
    sonar_cycle: int = 0  # ms
    gyro: int = 0
    drift_factor: int = 0  # 1/8192 of the left encoder's counts
    aux2_baud: int = 0
    aux3_baud: int = 0
    shutdown_volts: int = 0  # 0.1 V
    firmware: str = ""


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


# CONFIGpac between its strings (section 2.2): the tops stand before the name, the body behind it.
_TOPS = struct.Struct("<B5H")
_TOP_FIELDS = (
    *("four_motors", "rot_vel_top", "trans_vel_top", "rot_acc_top", "trans_acc_top", "pwm_max"),
)
_BODY = struct.Struct("<3B2HB3HB16H6Bh2B2H")
_BODY_FIELDS = (
    *("sip_cycle", "host_baud", "aux1_baud", "gripper", "front_sonar", "rear_sonar"),
    *("low_battery", "rev_count", "watchdog", "p2mpacs", "stall_val", "stall_count"),
    *("joy_vel", "joy_rot_vel", "rot_vel_max", "trans_vel_max", "rot_acc", "rot_decel"),
    *("rot_kp", "rot_kv", "rot_ki", "trans_acc", "trans_decel"),
    *("trans_kp", "trans_kv", "trans_ki", "front_bumps", "rear_bumps", "charger"),
    *("sonar_cycle", "auto_baud", "gyro", "drift_factor", "aux2_baud", "aux3_baud"),
    *("ticks_mm", "shutdown_volts"),
)
_TEXT_FIELDS = ("robot_class", "subclass", "serial", "name", "firmware")
_GYRO_SCALES = bytes(5)  # gyroCW, gyroCCW and kinematicsDelay, the last that we know


def decode_config(payload: bytes) -> ConfigReport | None:
    """Return the configuration, None if the packet is not one or is cut short."""
    parts = payload[1:].split(b"\0", 3)
    if payload[0] != CONFIG or len(parts) < 4 or len(parts[3]) < _TOPS.size:
        return None
    tops: dict[str, Any] = dict(zip(_TOP_FIELDS, _TOPS.unpack_from(parts[3]), strict=True))
    name, end, rest = parts[3][_TOPS.size :].partition(b"\0")
    if not end or len(rest) < _BODY.size:
        return None
    body: dict[str, Any] = dict(zip(_BODY_FIELDS, _BODY.unpack_from(rest), strict=True))
    firmware = rest[_BODY.size :].partition(b"\0")[0]
    texts = (text.decode("latin-1") for text in (*parts[:3], name, firmware))
    words: dict[str, Any] = dict(zip(_TEXT_FIELDS, texts, strict=True))
    return ConfigReport(**words, **tops, **body)


def encode_config(report: ConfigReport) -> bytes:
    """Return the payload of a CONFIGpac."""
    head, name, firmware = (
        b"".join(text.encode("latin-1") + b"\0" for text in texts)
        for texts in (
            (report.robot_class, report.subclass, report.serial), (report.name,), (report.firmware,)
        )
    )  # fmt: skip
    tops = _TOPS.pack(*(getattr(report, field) for field in _TOP_FIELDS))
    body = _BODY.pack(*(getattr(report, field) for field in _BODY_FIELDS))
    return bytes([CONFIG]) + head + tops + name + body + firmware + _GYRO_SCALES


class IoReport(NamedTuple):
    """Inputs and outputs of the user's port (section 2.2)."""

    digital_in: tuple[int, ...] = (0, 0, 0, 0)  # DIGIN, front and rear bumpers, infrared
    digital_out: tuple[int, ...] = (0,)
    analog: tuple[int, ...] = (0,) * 9  # 10 bits each


def decode_io(payload: bytes) -> IoReport | None:
    """Return the inputs and outputs, None if the packet is not an IOpac or is cut short."""
    if payload[0] != IO:
        return None
    groups, at = [], 1
    for width in (1, 1, 2):
        end = at + 1 + width * (payload[at] if at < len(payload) else 0)
        if end > len(payload) or at >= len(payload):
            return None
        values = payload[at + 1 : end]
        groups.append(tuple(struct.unpack(f"<{len(values) // width}{' BH'[width]}", values)))
        at = end
    return IoReport(*groups)


def encode_io(report: IoReport) -> bytes:
    """Return the payload of an IOpac."""
    groups = zip(report, "BBH", strict=True)
    packed = (struct.pack(f"<B{len(group)}{form}", len(group), *group) for group, form in groups)
    return bytes([IO]) + b"".join(packed)
