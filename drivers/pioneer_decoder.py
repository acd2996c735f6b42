"""From the bytes of a Pioneer to wheel odometry, live and in replay alike."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from slam.drivers.arcos_protocol import SYNC2, Framer, Id, Packet, decode_command
from slam.drivers.arcos_reports import (
    CONFIG,
    ENCODER,
    STANDARD,
    ConfigReport,
    EncoderReport,
    Identity,
    StandardReport,
    decode_config,
    decode_encoders,
    decode_identity,
    decode_standard,
)
from slam.drivers.report_cycle import ReportCycle
from slam.logs.messages import RawBytes, SensorMessage, WheelOdometry

_HALF_WRAP, _WRAP_MASK = 0x4000, 0x7FFF  # counters wrap at 15 bits (docs/devices.md, section 2.1)
_TURN = 4096  # THPOS units in a turn


@dataclass(frozen=True, slots=True)
class RobotModel:
    """Conversion factors of a subclass (section 3)."""

    metres: float  # m per unit of XPOS, YPOS
    radians: float = 2.0 * math.pi / _TURN  # rad per unit of THPOS
    speed_max: float = 2.2  # m/s, absolute maximum
    turn_max: float = math.radians(500.0)  # rad/s


_SH = RobotModel(metres=0.001)
# A robot delivered with a SICK laser bears that in its name; ARIA's files for it have the same
# factors as p3dx-sh (section 3).
MODELS: Mapping[str, RobotModel] = MappingProxyType(
    {
        "p3dx-sh": _SH,
        "p3dx-sh-lms1xx": _SH,
        "p3dx-sh-lms500": _SH,
        "p3dx": RobotModel(metres=0.000485),
    }
)


class PioneerDecoder:
    """Turns raw bytes of both directions into odometry; equal bytes and stamps, equal messages.

    `odom_T_base` starts at zero and goes on where it was when the robot's own count starts
    again: the motion in between is unknown, and counted as a restart.
    """

    def __init__(self, model: RobotModel | None = None) -> None:
        """Take the factors of `model`, or those of the subclass that the robot names."""
        self.identity: Identity | None = None
        self.config: ConfigReport | None = None
        self.encoders: EncoderReport | None = None
        self.latest: StandardReport | None = None
        self.reports = 0
        self.cut_reports = 0
        self.restarts = 0
        self.jumps = 0
        self._fixed, self._model = model, model
        self._framer, self._sent = Framer(), Framer()
        self._cycle = ReportCycle()
        self._odometry = WheelOdometry(0, 0.0, 0.0, 0.0)
        self._before: tuple[StandardReport, int] | None = None
        self._turned = 0.0  # rad, from the robot's own frame to ours

    @property
    def model(self) -> RobotModel | None:
        """The factors in use, None until the robot has named itself."""
        return self._model

    def counters(self) -> dict[str, int]:
        """What came in and what was lost, by cause."""
        return {
            "reports": self.reports,
            "cut_reports": self.cut_reports,
            "bad_checksums": self._framer.bad_checksums,
            "skipped_bytes": self._framer.skipped_bytes,
            "odometry_restarts": self.restarts,
            "odometry_jumps": self.jumps,
        }

    def decode(self, raw: RawBytes) -> Iterator[SensorMessage]:
        """Yield the odometry that these bytes complete."""
        for item in self.accept(raw):
            if not isinstance(item, Packet):
                yield item

    def accept(self, raw: RawBytes) -> Iterator[Packet | SensorMessage]:
        """Yield every packet from the robot, and behind it the odometry it carries."""
        if raw.direction == "tx":
            for packet in self._sent.feed(raw.data, raw.stamp_ns):
                command = decode_command(packet.payload)
                if command is not None and command.id == Id.SETO:
                    self._restart()
            return
        packets = self._framer.feed(raw.data, raw.stamp_ns)
        behind = sum(packet.id in STANDARD for packet in packets)
        for packet in packets:
            yield packet
            if packet.id in STANDARD:
                behind -= 1
                yield from self._standard(packet, behind)
            elif packet.id == SYNC2:
                self._identify(decode_identity(packet.payload))
            elif packet.id == CONFIG:
                self._configure(decode_config(packet.payload))
            elif packet.id == ENCODER:
                self.encoders = decode_encoders(packet.payload)

    def _identify(self, identity: Identity | None) -> None:
        """A connection begins; the robot may have been switched off since the last one."""
        if identity is not None:
            self.identity = identity
            self._model = self._fixed or MODELS.get(identity.subclass.lower())
            self._restart()

    def _configure(self, config: ConfigReport | None) -> None:
        self.config = config
        if config is not None and config.sip_cycle > 0:
            self._cycle.restart(config.sip_cycle * 1_000_000)

    def _restart(self) -> None:
        self._cycle.restart()
        if self._before is not None:
            self.restarts += 1
            self._before = None

    def _standard(self, packet: Packet, behind: int) -> Iterator[WheelOdometry]:
        report = decode_standard(packet.payload)
        if report is None:
            self.cut_reports += 1
        elif self._model is not None:
            self.latest = report
            self.reports += 1
            # The first byte is stamped: the rest takes 23 ms at 38400 baud, 93 ms at 9600.
            self._integrate(report, self._cycle.stamp(packet.begun_ns, behind), self._model)
            yield self._odometry

    def _integrate(self, report: StandardReport, stamp_ns: int, model: RobotModel) -> None:
        here = self._odometry
        if self._before is not None:
            before, then_ns = self._before
            dx = _wrapped(report.x - before.x) * model.metres
            dy = _wrapped(report.y - before.y) * model.metres
            turn = _turn(report.theta - before.theta) * model.radians
            if _is_possible(math.hypot(dx, dy), turn, stamp_ns - then_ns, model):
                cos, sin = math.cos(self._turned), math.sin(self._turned)
                x, y = here.x + cos * dx - sin * dy, here.y + sin * dx + cos * dy
                theta = math.remainder(here.theta + turn, math.tau)
                here = WheelOdometry(stamp_ns, x, y, theta)
            else:
                self.jumps += 1
                self._before = None
        if self._before is None:
            self._turned = here.theta - report.theta * model.radians
            here = WheelOdometry(stamp_ns, here.x, here.y, here.theta)
        self._before = report, stamp_ns
        self._odometry = here


def _wrapped(difference: int) -> int:
    """Fold the difference of two position counters (section 2.1)."""
    return ((difference + _HALF_WRAP) & _WRAP_MASK) - _HALF_WRAP


def _turn(difference: int) -> int:
    """Fold the difference of two headings to half a turn either way."""
    return (difference + _TURN // 2) % _TURN - _TURN // 2


def _is_possible(distance: float, turn: float, elapsed_ns: int, model: RobotModel) -> bool:
    """Whether a P3-DX can have moved so far; after a long gap the wraps are unknown.

    A report may come 0.3 s later than it should (jitter, a repeated 9600 baud packet).
    """
    elapsed = elapsed_ns * 1e-9 + 0.3
    if model.speed_max * elapsed > _HALF_WRAP * model.metres:
        return False
    return distance <= model.speed_max * elapsed and abs(turn) <= model.turn_max * elapsed
