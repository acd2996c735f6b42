"""Session with a Pioneer: synchronise from any state, keep alive, read, say goodbye.

Unless `PioneerConfig.motion` is given, only commands that cannot move the robot are sent,
and the motors are left as they are: an operator who drives by joystick keeps doing so.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from slam.drivers.arcos_protocol import (
    BAUD_CODES,
    OUT_OF_SYNC,
    SYNC0,
    SYNC1,
    SYNC2,
    Id,
    Packet,
    encode_command,
)
from slam.drivers.arcos_reports import CONFIG, ENCODER, GYRO, IO, STANDARD
from slam.drivers.connection import Clock, Connection, Sink, steady_utc
from slam.drivers.errors import LinkLost, NoReply, Refused, WrongDevice
from slam.drivers.motion import MotionConfig, MotionGuard
from slam.drivers.pioneer_decoder import MODELS, PioneerDecoder, RobotModel
from slam.drivers.ports import Port, open_port

# What may be sent without consent to motion.
PASSIVE = (Id.PULSE, Id.OPEN, Id.CLOSE, Id.CONFIG, Id.SONAR, Id.HOSTBAUD)
_REPORTS = (*STANDARD, CONFIG, ENCODER, IO, GYRO)
_PATIENT = 4  # silent rounds of SYNC before a known robot is told to CLOSE
_PACE_S = 0.005  # s between commands; the firmware may drop quicker ones (section 1)
_LISTEN_S, _GARBAGE = 0.2, 16  # s, and bytes in that time that are no packet
_Outcome = Literal["connected", "open", "confused", "garbage", "silent"]


@dataclass(frozen=True, kw_only=True, slots=True)
class PioneerConfig:
    """How to talk to the robot; sections are those of docs/devices.md."""

    port: str  # device path, or tcp://host:port
    baud: int = 9600  # HostBaud as delivered (section 1.1)
    fast_baud: int | None = 38400  # tried where the robot says it can (section 3); None: never
    sonar: bool = False  # sonar readings make reports too long for 9600 baud (section 7)
    pulse_s: float = 0.5  # s between signs of life, a quarter of the watchdog (section 1.2)
    reply_s: float = 1.0  # s for an answer to SYNC; repeating it earlier can close (section 1.1)
    silence_s: float = 1.0  # s without a report until the robot counts as gone; ten cycles
    attempts: int = 8  # rounds of SYNC0 to SYNC2 before giving up
    model: RobotModel | None = None  # factors to use whatever the robot calls itself
    motion: MotionConfig | None = None  # consent to motor power and motion commands

    def __post_init__(self) -> None:
        """Refuse speeds that ARCOS does not have and times that cannot work."""
        if self.baud not in BAUD_CODES or self.fast_baud not in (None, *BAUD_CODES):
            raise ValueError(f"ARCOS runs at {', '.join(map(str, BAUD_CODES))} baud")
        if not 0.0 < self.pulse_s <= 1.0 or self.reply_s < 1.0 or self.attempts < 1:
            raise ValueError("need pulse_s up to 1 s, reply_s of 1 s or more, attempts over 0")


class Pioneer:
    """One robot; everything happens in `connect`, `poll` and `close`, in the caller's thread."""

    device: Literal["p3dx"] = "p3dx"

    def __init__(
        self,
        config: PioneerConfig,
        sink: Sink,
        clock: Clock | None = None,
        opener: Callable[[str, int], Port] = open_port,
    ) -> None:
        self.decoder = PioneerDecoder(config.model)
        self._config, self._sink, self._opener = config, sink, opener
        self._cancelled = threading.Event()
        self._clock = clock or steady_utc()
        self._connection: Connection[Packet] | None = None
        self._guard = MotionGuard(config.motion) if config.motion else None
        self._baud = self._boot_baud = config.baud
        self._heard_ns = self._pulsed_ns = self._sent_ns = 0

    def connect(self) -> str:
        """Open the port and bring the robot to sending reports; returns who it is.

        A robot that is still sending since the link broke is taken up as it is, so that no
        motion is lost.

        Raises:
            PortError, LinkLost: about the port.
            NoReply: if nothing answers like a Pioneer, or no report follows.
            WrongDevice: if its conversion factors are unknown.
        """
        port = self._opener(self._config.port, self._baud)
        self._connection = Connection(
            self.device, port, self.decoder, self._sink, self._clock, self._cancelled
        )
        if self.decoder.identity is not None and self._await_report(0.3):
            return self._begun("resumed")
        if self._synchronise() == "open":
            return self._begun("resumed")
        identity = self.decoder.identity
        if identity is None:
            raise WrongDevice(f"{port.name} answers like a Pioneer but does not say who it is")
        if self.decoder.model is None:
            raise WrongDevice(
                f"{port.name} is {identity.robot_class} {identity.name} of the kind "
                f"{identity.subclass!r}, whose conversion factors are not known. Known are: "
                f"{', '.join(MODELS)}. If it is built like one of them, say so in robot.toml: "
                '[robot] model = "p3dx-sh"'
            )
        self._send(Id.OPEN)
        self._send(Id.SONAR, int(self._config.sonar))
        self._ask_config()
        if not self._await_report(2.0):
            raise NoReply(f"{identity.name} on {port.name} is connected but sends no reports")
        if self._guard is not None:
            self._send(Id.ENABLE, 1)
        return self._begun("connected")

    def poll(self, timeout_s: float = 0.02) -> None:
        """Read once, and send what is due.

        Raises:
            LinkLost: if the port is gone or the robot has started again.
            NoReply: if reports have ceased for `silence_s`.
        """
        for packet in self._link.receive(timeout_s):
            if packet.id in STANDARD:
                self._heard_ns = packet.stamp_ns
            elif packet.id in (SYNC0, OUT_OF_SYNC):
                raise LinkLost("the robot has restarted: it takes PULSE for SYNC0")
        now = self._clock()
        if now - self._heard_ns > self._config.silence_s * 1e9:
            raise NoReply(f"no report from the robot for {self._config.silence_s} s")
        if now - self._pulsed_ns >= self._config.pulse_s * 1e9:
            self._send(Id.PULSE)
            self._pulsed_ns = now
        if self._guard is not None and (speeds := self._guard.due(now)) is not None:
            self._send(Id.VEL, speeds[0])
            self._send(Id.RVEL, speeds[1])

    def drive(self, speed: float, turn_rate: float) -> None:
        """Ask for m/s and rad/s; repeat it more often than the dead-man's time.

        Raises:
            Refused: if the session was opened without consent to motion.
        """
        if self._guard is None:
            raise Refused("motion is off: this session was opened without a MotionConfig")
        self._guard.request(speed, turn_rate, self._clock())

    def close(self) -> None:
        """Stop what may move, close the robot's servers, and let go of the port."""
        self._cancelled.clear()
        try:
            if self._connection is not None:
                if self._guard is not None:
                    self._send(Id.STOP)
                    self._send(Id.ENABLE, 0)
                self._send(Id.CLOSE)
                self._link.drain(0.1, 0.3)
        except LinkLost:
            pass  # whom should we tell
        self.drop()
        self._baud = self._boot_baud  # robots fall back when their client goes (section 1.1)

    def cancel(self) -> None:
        """Make a `connect` that is under way in another thread end with `Stopped`."""
        self._cancelled.set()

    def drop(self) -> None:
        """Let go of the port without a word."""
        if self._connection is not None:
            self._connection.port.close()
            self._connection = None

    @property
    def _link(self) -> Connection[Packet]:
        if self._connection is None:
            raise LinkLost("not connected")
        return self._connection

    def _send(self, command: Id, argument: int | None = None) -> None:
        if command not in PASSIVE and self._guard is None:
            raise Refused(f"{command.name} is not sent without consent to motion")
        wait_s = _PACE_S - (self._clock() - self._sent_ns) * 1e-9
        if wait_s > 0.0:
            self._link.drain(wait_s, wait_s)
        self._link.send(encode_command(command, argument))
        self._sent_ns = self._clock()

    def _begun(self, how: str) -> str:
        self._heard_ns = self._clock()
        self._send(Id.PULSE)
        self._pulsed_ns = self._heard_ns
        who = self.decoder.identity
        name = (
            f"{who.robot_class} {who.subclass} {who.name}" if who is not None
            else "robot of the configured model"
        )  # fmt: skip
        return f"{how}: {name} on {self._config.port} at {self._baud} baud"

    def _synchronise(self) -> _Outcome:
        """Repeat the handshake until it works, at every speed if need be (section 1.1).

        Returns "open" if a robot that we know has answered with reports.
        """
        known = self.decoder.identity is not None
        bauds = self._bauds_to_try(known)
        self._use_baud(bauds[0])
        silences = 0
        faster = [baud for baud in self._fast_bauds() if baud != bauds[0]]
        for _ in range(self._config.attempts):
            outcome = self._handshake()
            if outcome == "connected":
                self._boot_baud = self._baud
            if outcome == "connected" or (outcome == "open" and known):
                return outcome
            if outcome == "garbage" and not known and faster:
                self._close_at(faster.pop(0), back_to=bauds[0])
                continue
            if outcome in ("silent", "garbage"):
                silences += 1
                self._use_baud(bauds[silences % len(bauds)])
                if known and silences < _PATIENT:
                    continue  # an outage; what we knew of the robot's odometry is worth a wait
            # CLOSE ends what an earlier client or a lost answer to SYNC2 left open.
            self._send(Id.CLOSE)
            self._link.drain(0.25, 2.0)
        raise NoReply(
            f"no Pioneer answers on {self._config.port}. Is this the port of the robot, is it "
            "switched on, is the cable in its HOST port, and does no other computer (a built-in "
            "PC) use that port?"
        )

    def _bauds_to_try(self, known: bool) -> list[int]:
        """Return speeds in turn.

        A robot that we know and hear no more has most likely restarted, and is back at the speed
        it boots with.
        """
        if not self._link.port.has_baud:
            return [self._baud]
        first = [self._boot_baud, self._baud] * 2 if known else [self._baud] * 2
        return [*first, *(baud for baud in BAUD_CODES if baud not in first)]

    def _fast_bauds(self) -> list[int]:
        """Return the speeds at which an earlier client may have left the robot sending."""
        if not self._link.port.has_baud:
            return []
        likely = [self._config.fast_baud] if self._config.fast_baud else []
        return [*likely, *(baud for baud in BAUD_CODES if baud not in likely)]

    def _close_at(self, baud: int, back_to: int) -> None:
        """Close a robot that sends at another speed: it falls back to the one it boots with.

        A robot that is not there at that speed takes this for noise.
        """
        self._use_baud(baud)
        self._send(Id.CLOSE)
        self._link.drain(0.05, 0.2)
        self._use_baud(back_to)

    def _use_baud(self, baud: int) -> None:
        self._link.port.set_baud(baud)
        self._baud = baud

    def _handshake(self) -> _Outcome:
        """Send SYNC0 to SYNC2, none of them twice: the second SYNC2 would mean CLOSE."""
        for stage in (SYNC0, SYNC1, SYNC2):
            self._link.drain(0.03, 0.5)
            self._link.send(encode_command(stage))
            outcome = self._answer(stage)
            if outcome != "connected":
                return outcome
        return "connected"

    def _answer(self, stage: int) -> _Outcome:
        """Wait for the echo of a SYNC; garbage instead of an answer comes of another speed."""
        skipped = self.decoder.counters()["skipped_bytes"]
        for _ in range(math.ceil(self._config.reply_s / _LISTEN_S)):
            for packet in self._link.receive_for(_LISTEN_S):
                if packet.id == stage:
                    return "connected"
                if packet.id in _REPORTS:
                    return "open"
                if packet.id == OUT_OF_SYNC:
                    return "confused"
            garbage = self.decoder.counters()["skipped_bytes"] - skipped
            if stage == SYNC0 and garbage > _GARBAGE:
                return "garbage"  # a SYNC0 too many does no harm, another one would
        return "silent"

    def _await_report(self, seconds: float) -> bool:
        return any(packet.id in STANDARD for packet in self._link.receive_for(seconds))

    def _ask_config(self) -> None:
        """Ask for the CONFIGpac, which a real p3dx-sh sends with a wrong sum: do without it then.

        Only a robot that says it can is asked to go faster (section 1.1).
        """
        self._send(Id.CONFIG)
        for packet in self._link.receive_for(self._config.reply_s):
            if packet.id == CONFIG:
                break
        config, fast = self.decoder.config, self._config.fast_baud
        if config is None or config.auto_baud != 2 or fast is None or fast <= self._baud:
            return
        if not self._link.port.has_baud:
            return
        slow = self._baud
        self._send(Id.HOSTBAUD, BAUD_CODES[fast])
        self._link.drain(0.03, 0.03)  # 9 ms on the line, and 10 ms for the robot
        self._use_baud(fast)
        self._send(Id.PULSE)
        if not self._await_report(0.9):
            self._use_baud(slow)
