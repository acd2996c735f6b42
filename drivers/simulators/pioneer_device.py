"""A simulated P3-DX behind its serial port: the controller's states, not the client's."""

from __future__ import annotations

import math
from collections.abc import Callable

from gtsam import Pose2
from slam.drivers.arcos_protocol import (
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
from slam.drivers.arcos_reports import (
    MOTORS_ENABLED,
    STOP_BUTTON,
    Identity,
    IoReport,
    StandardReport,
    encode_config,
    encode_encoders,
    encode_identity,
    encode_io,
    encode_standard,
)
from slam.drivers.pioneer_decoder import MODELS
from slam.drivers.simulators.faults import TRACK_WIDTH_M
from slam.drivers.simulators.motion import Motion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_wheels import Encoders, Wheels
from slam.drivers.simulators.sonar import echoes
from slam.drivers.simulators.world import World

_VOLTS10 = 128  # 0.1 V, a battery that is well charged
_CONNECTED = 3  # stage behind the three SYNCs
_SONAR_ARRAYS = 0x1E  # FLAGS bits of the four arrays (section 2)


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
        self.stop_pressed = False  # somebody holds the robot with its STOP button
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
        self._sonar, self._motors = True, self.build.motors_enabled
        self._sends_encoders = self._sends_io = 0  # 0: not, 1: once, 2: behind every report
        self._origin = Pose2(*self._motion.odometry(now_s))
        self._next_report = self._heard_s = now_s
        self._volts10 = _VOLTS10
        config = self.build.config()
        self._wheels = Wheels(
            self._motion,
            (config.trans_vel_max / 1000.0, math.radians(config.rot_vel_max)),
            (config.trans_vel_top / 1000.0, math.radians(config.rot_vel_top)),
        )
        self._encoders, self._tripped = Encoders(self._origin), False
        self._out = bytearray()

    def prepare(self) -> None:
        """Listen to the sonar once before anybody asks: that loads its kernels."""
        echoes(self._motion, self._world, 0.0)

    def client_left(self) -> None:
        """Nothing: a robot learns of it by its watchdog alone."""

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
            self._report(self._next_report)
            self._next_report += self.build.cycle_s
        sent, self._out = bytes(self._out), bytearray()
        return sent

    def _report(self, now_s: float) -> None:
        """Send what is due in every cycle; encoders and inputs come behind the standard report."""
        self._out += encode_packet(self._standard(now_s))
        self.reports += 1
        self._encoders.roll_to(Pose2(*self._motion.odometry(now_s)))
        if self._sends_encoders:
            self._out += encode_packet(encode_encoders(self._encoders.report()))
            self._sends_encoders -= self._sends_encoders == 1
        if self._sends_io:
            self._out += encode_packet(encode_io(IoReport()))
            self._sends_io -= self._sends_io == 1

    def _watch(self, now_s: float) -> None:
        """Stop when the client is silent, go on when it is back (section 1.2)."""
        silent = self.connected and now_s - self._heard_s > self.build.watchdog_s
        if silent and not self._tripped:
            self.watchdog_trips += 1
        if silent != self._tripped:
            self._wheels.hold(now_s, silent)
        self._tripped = silent
        self._wheels.steer(now_s)

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
        wheels = self._wheels
        return {
            Id.OPEN: self._start,
            Id.CLOSE: self._close,
            Id.ENABLE: self._enable,
            Id.SETO: self._set_origin,
            Id.SETV: lambda value, _: wheels.limit(value / 1000.0, None),
            Id.SETRV: lambda value, _: wheels.limit(None, math.radians(value)),
            Id.MOVE: self._powered(lambda value, now: wheels.move(now, value / 1000.0)),
            Id.HEAD: self._powered(self._head),
            Id.DHEAD: self._powered(self._turn),
            Id.DCHEAD: self._powered(self._turn_on),
            Id.VEL: lambda value, now: self._go(now, speed=value / 1000.0),
            Id.RVEL: lambda value, now: self._go(now, turn_rate=math.radians(value)),
            Id.ROTATE: lambda value, now: self._go(now, turn_rate=math.radians(value)),
            Id.VEL2: self._each_wheel,
            Id.STOP: lambda _, now: self._go(now, 0.0, 0.0),
            Id.E_STOP: lambda _, now: self._go(now, 0.0, 0.0),
            Id.SONAR: self._set_sonar,
            Id.CONFIG: self._send_config,
            Id.ENCODER: self._set_encoders,
            Id.IOREQUEST: self._set_io,
            Id.HOSTBAUD: self._set_baud,
            Id.BATTEST: self._fake_battery,
            Id.RESET: lambda _, now: self._power_on(now),
        }

    def _start(self, _: int, now_s: float) -> None:
        self._motion.power(now_s, on=True)  # after a restart its operator waits for this
        if not self._open:
            self._open, self._next_report = True, now_s + self.build.cycle_s

    def _close(self, _: int, now_s: float) -> None:
        self._go(now_s, 0.0, 0.0)
        self._stage, self._open = 0, False
        self._sends_encoders = self._sends_io = 0
        self.baud = self.build.baud

    def _enable(self, value: int, now_s: float) -> None:
        self._motors = value != 0
        if not self._motors:
            self._go(now_s, 0.0, 0.0)

    def _set_origin(self, _: int, now_s: float) -> None:
        self._origin = Pose2(*self._motion.odometry(now_s))

    def _each_wheel(self, value: int, now_s: float) -> None:
        """VEL2: right wheel in the low byte, in 20 mm/s (section 1.3)."""
        right, left = ((byte + 128) % 256 - 128 for byte in (value & 0xFF, value >> 8 & 0xFF))
        self._go(now_s, (left + right) * 0.01, (right - left) * 0.02 / TRACK_WIDTH_M)

    def _go(self, now_s: float, speed: float | None = None, turn_rate: float | None = None) -> None:
        if self._motors:
            self._wheels.go(now_s, speed, turn_rate)
        else:
            self._wheels.go(now_s, 0.0, 0.0)

    def _powered(self, action: Callable[[int, float], None]) -> Callable[[int, float], None]:
        """Do it only with the motors on."""
        return lambda value, now_s: action(value, now_s) if self._motors else None

    def _head(self, degrees: int, now_s: float) -> None:
        """HEAD counts from where the odometry began (SETO)."""
        self._wheels.head(now_s, self._origin.theta() + math.radians(degrees))

    def _turn(self, degrees: int, now_s: float) -> None:
        self._wheels.head(now_s, self._wheels.heading(now_s) + math.radians(degrees))

    def _turn_on(self, degrees: int, now_s: float) -> None:
        self._wheels.head(now_s, self._wheels.wanted_heading(now_s) + math.radians(degrees))

    def _set_sonar(self, value: int, _: float) -> None:
        self._sonar = value & 1 == 1

    def _set_encoders(self, value: int, _: float) -> None:
        self._sends_encoders = min(value, 2)

    def _set_io(self, value: int, _: float) -> None:
        self._sends_io = min(value, 2)

    def _fake_battery(self, value: int, _: float) -> None:
        self._volts10 = value or _VOLTS10

    def _set_baud(self, value: int, _: float) -> None:
        bauds = {code: baud for baud, code in BAUD_CODES.items()}
        if self.build.auto_baud and value in bauds:
            self.baud = bauds[value]

    def _send_config(self, _: int, now_s: float) -> None:
        if not self.build.answers_config:
            return
        packet = bytearray(encode_packet(encode_config(self.build.config())))
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
            battery=min(self._volts10, 255),
            flags=(
                MOTORS_ENABLED * self._motors
                | _SONAR_ARRAYS * self._sonar
                | STOP_BUTTON * self.stop_pressed
            ),
            sonar=echoes(self._motion, self._world, now_s) if self._sonar else (),
            moving=self.build.tells_moving and (speed, turn_rate) != (0.0, 0.0),
            grip_state=0,
            analog_port=0,
            analog=0,
            digital_in=0,
            digital_out=0,
            battery_x10=self._volts10,
            charge_state=0,
            rot_vel=round(math.degrees(turn_rate) * 10.0),
            fault_flags=0,
            lat_vel=0,
            temperature=-128,
            charge_percent=90,
        )
        payload = encode_standard(report)
        return payload[: len(payload) - (16 - self.build.tail_bytes)]
