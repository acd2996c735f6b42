"""A simulated Hokuyo behind USB, RS232 or Ethernet: states and answers of the sensor itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from slam.drivers.scip_protocol import (
    Command,
    CommandFramer,
    data_lines,
    decode_command,
    encode_number,
    encode_reply,
    with_sum,
)
from slam.drivers.scip_scan import SCAN_SYMBOLS, ScanRequest, decode_request
from slam.drivers.simulators.hokuyo_answers import (
    information,
    no_command,
    no_scan,
    old_version,
    parameters,
    version,
)
from slam.drivers.simulators.hokuyo_models import MODELS, HokuyoModel
from slam.drivers.simulators.sweep import Sweeper

_SPEEDS = (19200, 38400, 57600, 115200, 250000, 500000, 750000)
_BAUD = 19200  # as delivered
_SPEED_S = 0.02  # s behind a command until its speed counts: the answer goes at the old one
_REBOOT_S = 0.05  # s from the answer to RB until the sensor is gone; our estimate
_STATES = {"idle": "000", "clock": "002", "on": "003", "stream": "004", "asleep": "005"}


@dataclass(frozen=True, kw_only=True, slots=True)
class HokuyoBuild:
    """Which sensor it is, and what is wrong with it; sections are those of docs/devices.md."""

    model: str = "utm-30lx"
    serial: str = "H0000001"
    clock_start: int = 0  # count at the start of the simulation, up to 2**24
    clock_rate: float = 1.0  # sensor seconds per second; 50 ppm off is usual (section 4.3)
    boot_s: float = 0.0  # s after power-on without an answer (section 4.6)
    boot_status: str = ""  # with which commands are answered meanwhile; empty: not at all
    processing_s: float = 0.001  # s from the last step to the first byte; our estimate
    allows_sync: bool = True  # False: TM is denied
    spin_up_s: float = 0.0  # s from a stream's command to its first sweep
    checks: tuple[tuple[float, float], ...] = ()  # s, begin and end: it checks itself
    check_status: str = "21"  # what it sends meanwhile in place of scans
    clock_jumps: tuple[tuple[float, int], ...] = ()  # (s of simulation, ms its counter jumps by)
    fault_at_s: float = math.inf  # s, from then on reports carry hardware status 50
    damaged_version: bool = False  # a stray line and a wrong sum in VV (section 6)
    reboots: tuple[tuple[float, float], ...] = ()  # (s of simulation, s it takes)

    def __post_init__(self) -> None:
        """Refuse sensors that do not exist."""
        if self.model not in MODELS or self.clock_rate <= 0.0:
            raise ValueError(f"no such sensor: {self}; models are {', '.join(MODELS)}")


class HokuyoDevice:
    """Takes bytes and time, gives bytes; time is seconds of simulation and never goes back."""

    def __init__(self, sweeper: Sweeper, build: HokuyoBuild | None = None) -> None:
        """Measure by `sweeper`, which must be for the same model."""
        self.build = build or HokuyoBuild()
        self.model: HokuyoModel = MODELS[self.build.model]
        if sweeper.model is not self.model:
            raise ValueError("sweeper and sensor are of different models")
        self.reports = 0
        self._sweeper = sweeper
        self._reboots = list(self.build.reboots)
        self._power_on(0.0)
        self._count_at_start = self.build.clock_start

    def _power_on(self, now_s: float) -> None:
        self.baud = _BAUD
        self._new_baud: tuple[int, float] | None = None  # and when it takes effect
        self._ready_s = now_s + self.build.boot_s
        self._framer, self._out = CommandFramer(), bytearray()
        self._state = "idle"
        self._request: ScanRequest | None = None
        self._note, self._left = "", 0
        self._next_sweep, self._turns_s = 0, now_s
        self._old = self.model.starts_old
        self._reboot_asked_s = -math.inf
        self._zero_clock(now_s)

    def _zero_clock(self, now_s: float) -> None:
        self._started_s, self._count_at_start = now_s, 0

    def count(self, time_s: float) -> int:
        """Return the sensor's millisecond counter."""
        passed = (time_s - self._started_s) * self.build.clock_rate
        jumped = sum(jump for at, jump in self.build.clock_jumps if self._started_s <= at <= time_s)
        return (self._count_at_start + math.floor(passed * 1000.0 + 1e-6) + jumped) % (1 << 24)

    @property
    def state(self) -> str:
        """idle, clock, on (laser lit), stream or asleep."""
        return self._state

    @property
    def _sweep_s(self) -> float:
        """Seconds from one sweep to the next; the motor is clocked by the sensor's own quartz."""
        return self.model.parameters.sweep_s / self.build.clock_rate

    def prepare(self) -> None:
        """Measure once before anybody asks: the first sweep takes half a second to load kernels."""
        sensor = self.model.parameters
        self._sweeper.distances(ScanRequest("GD", sensor.first_step, sensor.last_step), 0.0)

    def client_left(self) -> None:
        """A sensor on the network stops when its client has gone; on USB it cannot know."""
        if self.model.ethernet:
            self._state = "idle"

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the client."""
        booting = now_s < self._ready_s
        if booting and not self.build.boot_status:
            return
        for line in self._framer.feed(data):
            if booting:
                self._out += encode_reply(line, self.build.boot_status)
                continue
            command = decode_command(line)
            if self._old and line == b"V":
                self._out += old_version(self.model, self.build.serial)
            elif self._old and (command is None or command.symbol != "SCIP2.0"):
                self._out += line + b"\nE\n\n"
            elif command is None:
                self._out += encode_reply(line, no_command(line))
            else:
                self._answer(line, command, now_s)

    def advance(self, now_s: float) -> bytes:
        """Let time pass and return what the sensor sends up to `now_s`."""
        if self._reboots and now_s >= self._reboots[0][0]:
            _, takes = self._reboots.pop(0)
            self._power_on(now_s)
            self._ready_s = now_s + takes
        if self._new_baud is not None and now_s >= self._new_baud[1]:
            self.baud, self._new_baud = self._new_baud[0], None
        if self._state == "stream" and self._request is not None:
            self._stream(now_s, self._request)
        sent, self._out = bytes(self._out), bytearray()
        return sent

    def _stream(self, now_s: float, request: ScanRequest) -> None:
        while self._state == "stream" and self._due_s(request) <= now_s:
            sweep = self._next_sweep
            self._next_sweep += request.skip + 1
            remaining = max(0, self._left - 1)
            echo = replace(request, count=remaining).encode() + self._note.encode()
            starts = sweep * self._sweep_s
            if starts < self._turns_s:
                continue
            if status := self._trouble(starts):
                self._out += encode_reply(echo, status)
            else:
                lines = self._sweeper.report(request, starts, self.count(starts))
                self._out += encode_reply(echo, "99", lines)
            self.reports += 1
            if self._left:
                self._left = remaining
                self._state = "stream" if remaining else "idle"

    def _trouble(self, time_s: float) -> str:
        """Return what stands in place of a scan's status, "" if nothing is wrong."""
        if time_s >= self.build.fault_at_s:
            return "50"
        checks = any(begin <= time_s < end for begin, end in self.build.checks)
        return self.build.check_status if checks else ""

    def _due_s(self, request: ScanRequest) -> float:
        """Return when the report of the next sweep is ready: behind its last step."""
        sensor = self.model.parameters
        seen = sensor.last_step / sensor.steps_per_turn * self._sweep_s
        return self._next_sweep * self._sweep_s + seen + self.build.processing_s

    def _answer(self, line: bytes, command: Command, now_s: float) -> None:
        if command.symbol in SCAN_SYMBOLS:
            self._out += self._scan(line, command, now_s)
        elif self._state == "clock" and command.symbol not in ("TM", "II", "VV", "RS", "RB", "%ST"):
            self._out += encode_reply(line, "0E")
        else:
            status, lines = self._act(command, now_s)
            self._out += encode_reply(line, status, lines)

    def _act(self, command: Command, now_s: float) -> tuple[str, list[bytes]]:
        """Do what a command other than a scan says; returns status and lines (section 4.1)."""
        match command.symbol:
            case "VV":
                return "00", version(self.model, self.build.serial, self.build.damaged_version)
            case "PP":
                return "00", parameters(self.model)
            case "II":
                lit, sound = self._state in ("on", "stream"), now_s < self.build.fault_at_s
                return "00", information(self.model, self.count(now_s), lit, sound)
            case "BM":
                already = self._state in ("on", "stream")
                self._state = self._state if already else "on"
                return "02" if already else "00", []
            case "QT" | "%SL":
                self._state = "idle" if command.symbol == "QT" else "asleep"
                return "00", []
            case "RS" | "RT":
                if command.symbol == "RT" and not self.model.ethernet:
                    return "0E", []
                self._state = "idle"
                self._zero_clock(now_s)
                if command.symbol == "RS":
                    self._new_baud = _BAUD, now_s + _SPEED_S
                return "00", []
            case "RB":
                return self._reboot(now_s)
            case "TM":
                return self._keep_time(command.digits, now_s)
            case "SS":
                return self._set_speed(command.digits, now_s), []
            case "CR" | "HS":
                fixed = command.symbol == "CR" and not self.model.serial_speeds
                return "04" if fixed else "03", []
            case "%ST" if self.model.ethernet:
                return "00", [with_sum(_STATES[self._state].encode())]
            case "SCIP2.0":
                old, self._old = self._old, False
                return "00" if old else "0E", []
            case _:
                return "0E", []

    def _reboot(self, now_s: float) -> tuple[str, list[bytes]]:
        if now_s - self._reboot_asked_s > 1.0:
            self._reboot_asked_s = now_s
            return "01", []
        self._reboots.insert(0, (now_s + _REBOOT_S, max(self.build.boot_s, 1.0)))
        return "00", []

    def _keep_time(self, mode: str, now_s: float) -> tuple[str, list[bytes]]:
        if not self.build.allows_sync or self._state == "stream":
            return "10", []
        inside = self._state == "clock"
        if mode == "0":
            self._state = "clock"
            return "02" if inside else "00", []
        if mode == "1":
            lines = data_lines(encode_number(self.count(now_s), 4))
            return ("00", lines) if inside else ("04", [])
        if mode == "2":
            self._state = "idle" if inside else self._state
            return "00" if inside else "03", []
        return "01", []

    def _set_speed(self, digits: str, now_s: float) -> str:
        if self.model.ethernet:
            return "0F"
        if len(digits) != 6 or int(digits) not in _SPEEDS:
            return "02"
        if int(digits) == self.baud:
            return "03"
        if self.model.serial_speeds:
            self._new_baud = int(digits), now_s + _SPEED_S
        return "00"

    def _scan(self, line: bytes, command: Command, now_s: float) -> bytes:
        if self._state == "clock":
            return encode_reply(line, "0E")
        request, refusal = decode_request(line), no_scan(line, self.model.points)
        if request is None or refusal:
            return encode_reply(line, refusal)
        if request.streams:
            if self._state not in ("on", "stream"):
                self._turns_s = now_s + self.build.spin_up_s
            self._state, self._left = "stream", request.count
            self._request, self._note = request, "" if command.note is None else f";{command.note}"
            self._next_sweep = math.ceil(now_s / self._sweep_s)
            return encode_reply(line, "00")
        if self._state not in ("on", "stream"):
            return encode_reply(line, "10")
        sensor = self.model.parameters
        seen_s = sensor.last_step / sensor.steps_per_turn * self._sweep_s
        latest = max(0, math.floor((now_s - seen_s) / self._sweep_s))
        starts = latest * self._sweep_s
        return encode_reply(line, "00", self._sweeper.report(request, starts, self.count(starts)))
