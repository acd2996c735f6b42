"""A simulated P3-DX behind its serial port: the controller's states, not the client's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2

from drivers.arcos_protocol import (
    BAUD_CODES,
    OUT_OF_SYNC,
    SYNC0,
    SYNC2,
    Command,
    Framer,
    Id,
    decode_command,
    encode_packet,
)
from drivers.arcos_reports import (
    MOTORS_ENABLED,
    ConfigReport,
    EncoderReport,
    Identity,
    StandardReport,
    encode_config,
    encode_encoders,
    encode_identity,
    encode_standard,
)
from drivers.pioneer_decoder import MODELS
from drivers.simulators.faults import TRACK_WIDTH_M
from drivers.simulators.motion import Motion
from drivers.simulators.world import World

_TICKS_PER_M = 128_000.0  # what users set (DEVICES.md, section 3)
_CONNECTED = 3  # stage behind the three SYNCs
_SONAR_BEARINGS = np.radians(
    [90, 50, 30, 10, -10, -30, -50, -90, -90, -130, -150, -170, 170, 150, 130, 90]
)
_SONAR_ARRAYS = 0x1E  # FLAGS bits of the four arrays (section 2)
_SONAR_REACH_M = 5.0  # farther is reported as 5000: no echo (section 3)


@dataclass(frozen=True, kw_only=True, slots=True)
class PioneerBuild:
    """Which robot it is, and what is wrong with it; sections are those of DEVICES.md."""

    name: str = "simulated_1"
    subclass: str = "p3dx-sh"
    baud: int = 9600  # HostBaud in FLASH
    cycle_s: float = 0.1  # s, SipCycle
    watchdog_s: float = 2.0  # s without a packet until the robot stops (section 1.2)
    auto_baud: bool = True  # takes HOSTBAUD
    motors_enabled: bool = True  # somebody has pressed the MOTORS button
    tells_moving: bool = True  # False: type 0x32 always, as AMRISim does
    tail_bytes: int = 16  # of the standard report behind the sonar; old firmware sends fewer
    bad_config_sum: bool = False  # as a real p3dx-sh sends it (section 2.2)
    answers_config: bool = True
    counts_16_bits: bool = False  # position counter of AMRISim instead of 15 bits
    reboots: tuple[tuple[float, float], ...] = ()  # (s of simulation, s it takes)

    def __post_init__(self) -> None:
        """Refuse robots that do not exist."""
        if self.subclass not in MODELS or self.baud not in BAUD_CODES or self.cycle_s <= 0.0:
            raise ValueError(f"no such robot: {self}")


class PioneerDevice:
    """Takes bytes and time, gives bytes; time is seconds of simulation and never goes back."""

    def __init__(
        self, motion: Motion, build: PioneerBuild | None = None, world: World | None = None
    ) -> None:
        """Move by `motion`; sonar echoes come from `world`, without one there are none."""
        self.build = build or PioneerBuild()
        self.commands: list[Command] = []  # all that were understood, for tests
        self.watchdog_trips = 0
        self.reports = 0  # standard reports sent
        self._motion, self._world = motion, world
        self._reboots = list(self.build.reboots)
        self._boots_until = -math.inf
        self._power_on(0.0)

    @property
    def connected(self) -> bool:
        """Whether a client has synchronised."""
        return self._stage == _CONNECTED

    @property
    def sending(self) -> bool:
        """Whether the servers are open."""
        return self._open

    def _power_on(self, now_s: float) -> None:
        self.baud = self.build.baud
        self._framer = Framer()
        self._stage, self._open = 0, False
        self._sonar, self._motors, self._encoders = True, self.build.motors_enabled, 0
        self._origin = Pose2(*self._motion.odometry(now_s))
        self._next_report = self._heard_s = now_s
        self._setpoints, self._tripped = (0.0, 0.0), False
        self._limits = (1.0, math.radians(150.0))
        self._out = bytearray()

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the client."""
        if now_s < self._boots_until:
            return
        for packet in self._framer.feed(data, round(now_s * 1e9)):
            command = decode_command(packet.payload)
            if command is not None:
                self._heard_s = now_s
                self.commands.append(command)
                self._obey(command, now_s)

    def advance(self, now_s: float) -> bytes:
        """Let time pass and return what the robot sends up to `now_s`."""
        if self._reboots and now_s >= self._reboots[0][0]:
            at, takes = self._reboots.pop(0)
            self._boots_until = at + takes
            self._motion.power(now_s, on=False)
            self._power_on(now_s)
        if now_s < self._boots_until:
            return b""
        self._watch(now_s)
        while self._open and self._next_report <= now_s:
            self._out += encode_packet(self._standard(self._next_report))
            self.reports += 1
            if self._encoders:
                self._out += encode_packet(encode_encoders(self._counts(self._next_report)))
                self._encoders -= self._encoders == 1
            self._next_report += self.build.cycle_s
        sent, self._out = bytes(self._out), bytearray()
        return sent

    def _watch(self, now_s: float) -> None:
        """Stop when the client is silent, go on when it is back (section 1.2)."""
        silent = self.connected and now_s - self._heard_s > self.build.watchdog_s
        if silent and not self._tripped:
            self.watchdog_trips += 1
            self._motion.command(now_s, 0.0, 0.0)
        elif self._tripped and not silent:
            self._motion.command(now_s, *self._setpoints)
        self._tripped = silent

    def _obey(self, command: Command, now_s: float) -> None:
        if self._stage != _CONNECTED:
            self._synchronise(command.id)
            return
        action = self._actions().get(command.id)
        if action is not None:
            action(command.argument if isinstance(command.argument, int) else 0, now_s)

    def _synchronise(self, number: int) -> None:
        """SYNC0 begins anew at any time; the others must come in their order (section 1.1).

        Before the first SYNC0 others are ignored: a client's CLOSE to be sure is no SYNC2.
        """
        if number not in (SYNC0, self._stage):
            if number <= SYNC2 and self._stage > 0:
                self._out += encode_packet(bytes([OUT_OF_SYNC]))
            return
        self._stage = number + 1
        if number == SYNC2:
            identity = Identity(self.build.name, "Pioneer", self.build.subclass)
            self._out += encode_packet(encode_identity(identity))
        else:
            self._out += encode_packet(bytes([number]))

    def _actions(self) -> dict[int, Callable[[int, float], None]]:
        return {
            Id.OPEN: self._start,
            Id.CLOSE: self._close,
            Id.ENABLE: self._enable,
            Id.SETO: self._set_origin,
            Id.SETV: lambda value, _: self._limit(value / 1000.0, None),
            Id.SETRV: lambda value, _: self._limit(None, math.radians(value)),
            Id.VEL: lambda value, now: self._go(now, speed=value / 1000.0),
            Id.RVEL: lambda value, now: self._go(now, turn_rate=math.radians(value)),
            Id.VEL2: self._wheels,
            Id.STOP: lambda _, now: self._go(now, 0.0, 0.0),
            Id.E_STOP: lambda _, now: self._go(now, 0.0, 0.0),
            Id.SONAR: self._set_sonar,
            Id.CONFIG: self._send_config,
            Id.ENCODER: self._set_encoders,
            Id.HOSTBAUD: self._set_baud,
            Id.RESET: lambda _, now: self._power_on(now),
        }

    def _start(self, _: int, now_s: float) -> None:
        self._motion.power(now_s, on=True)  # after a restart its operator waits for this
        if not self._open:
            self._open, self._next_report = True, now_s + self.build.cycle_s

    def _close(self, _: int, now_s: float) -> None:
        self._go(now_s, 0.0, 0.0)
        self._stage, self._open, self._encoders = 0, False, 0
        self.baud = self.build.baud

    def _enable(self, value: int, now_s: float) -> None:
        self._motors = value != 0
        if not self._motors:
            self._go(now_s, 0.0, 0.0)

    def _set_origin(self, _: int, now_s: float) -> None:
        self._origin = Pose2(*self._motion.odometry(now_s))

    def _limit(self, speed: float | None, turn_rate: float | None) -> None:
        self._limits = (speed or self._limits[0], turn_rate or self._limits[1])

    def _wheels(self, value: int, now_s: float) -> None:
        """VEL2: right wheel in the low byte, in 20 mm/s (section 1.3)."""
        right, left = ((byte + 128) % 256 - 128 for byte in (value & 0xFF, value >> 8 & 0xFF))
        self._go(now_s, (left + right) * 0.01, (right - left) * 0.02 / TRACK_WIDTH_M)

    def _go(self, now_s: float, speed: float | None = None, turn_rate: float | None = None) -> None:
        wanted = (
            self._setpoints[0] if speed is None else speed,
            self._setpoints[1] if turn_rate is None else turn_rate,
        )
        if not self._motors:
            wanted = (0.0, 0.0)
        bounds = zip(wanted, self._limits, strict=True)
        speed, turn_rate = (min(max(value, -most), most) for value, most in bounds)
        self._setpoints = (speed, turn_rate)
        self._motion.command(now_s, speed, turn_rate)

    def _set_sonar(self, value: int, _: float) -> None:
        self._sonar = value & 1 == 1

    def _set_encoders(self, value: int, _: float) -> None:
        self._encoders = min(value, 2)

    def _set_baud(self, value: int, _: float) -> None:
        bauds = {code: baud for baud, code in BAUD_CODES.items()}
        if self.build.auto_baud and value in bauds:
            self.baud = bauds[value]

    def _send_config(self, _: int, now_s: float) -> None:
        if not self.build.answers_config:
            return
        report = ConfigReport(
            robot_class="Pioneer",
            subclass=self.build.subclass,
            serial="SIM_0001",
            name=self.build.name,
            rot_vel_top=360,
            trans_vel_top=1000,
            sip_cycle=round(self.build.cycle_s * 1000.0),
            host_baud=BAUD_CODES[self.build.baud],
            watchdog=round(self.build.watchdog_s * 1000.0),
            auto_baud=2 if self.build.auto_baud else 0,
            rev_count=16570,
            ticks_mm=128,
        )
        packet = bytearray(encode_packet(encode_config(report)))
        packet[-1] ^= 0xFF if self.build.bad_config_sum else 0
        self._out += packet

    def _standard(self, now_s: float) -> bytes:
        model = MODELS[self.build.subclass]
        pose = self._origin.between(Pose2(*self._motion.odometry(now_s)))
        speed, turn_rate = self._motion.speeds(now_s)
        difference = 0.5 * turn_rate * TRACK_WIDTH_M
        mask = 0xFFFF if self.build.counts_16_bits else 0x7FFF
        report = StandardReport(
            x=round(pose.x() / model.metres) & mask,
            y=round(pose.y() / model.metres) & mask,
            theta=round(pose.theta() / model.radians),
            left_vel=round((speed - difference) * 1000.0),
            right_vel=round((speed + difference) * 1000.0),
            battery=128,
            flags=MOTORS_ENABLED * self._motors | _SONAR_ARRAYS * self._sonar,
            sonar=self._echoes(now_s) if self._sonar else (),
            moving=self.build.tells_moving and (speed, turn_rate) != (0.0, 0.0),
            grip_state=0,
            analog_port=0,
            analog=0,
            digital_in=0,
            digital_out=0,
            battery_x10=128,
            charge_state=0,
            rot_vel=round(math.degrees(turn_rate) * 10.0),
            fault_flags=0,
            lat_vel=0,
            temperature=-128,
            charge_percent=90,
        )
        payload = encode_standard(report)
        return payload[: len(payload) - (16 - self.build.tail_bytes)]

    def _echoes(self, now_s: float) -> tuple[tuple[int, int], ...]:
        ranges = np.full(len(_SONAR_BEARINGS), _SONAR_REACH_M)
        if self._world is not None:
            pose = Pose2(*self._motion.truth(np.array([now_s]))[0].tolist())
            order = np.argsort(_SONAR_BEARINGS + 1e-6 * np.arange(len(_SONAR_BEARINGS)))
            bearings = (_SONAR_BEARINGS + 1e-6 * np.arange(len(_SONAR_BEARINGS)))[order]
            ranges[order] = np.minimum(
                self._world.cast(pose, bearings, _SONAR_REACH_M), _SONAR_REACH_M
            )
        return tuple((i, round(r * 1000.0)) for i, r in enumerate(ranges.tolist()))

    def _counts(self, now_s: float) -> EncoderReport:
        """Encoder counts of a straight drive; only their liveness is simulated."""
        count = round(self._motion.odometry(now_s)[0] * _TICKS_PER_M)
        return EncoderReport(count, count)
