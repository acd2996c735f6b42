"""Session with a Hokuyo: calm it down, ask who it is, set the clock, stream."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from slam.drivers.connection import (
    Clock,
    Connection,
    DeviceEvent,
    EventKind,
    Received,
    Sink,
    steady_utc,
)
from slam.drivers.errors import LinkLost, NoReply, Refused, WrongDevice
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.ports import Port, open_port
from slam.drivers.scip_protocol import Reply
from slam.drivers.scip_scan import ScanRequest, ScanSymbol, SensorParameters, decode_request

_SELF_CHECK_S = 60.0  # s that a sensor may take to check itself; our estimate
_BAUDS = (19200, 115200, 57600, 38400, 250000, 500000, 750000)  # RS232 models (section 4.1, SS)


@dataclass(frozen=True, kw_only=True, slots=True)
class HokuyoConfig:
    """What to ask of the sensor; sections are those of docs/devices.md.

    The paper's 181 beams at 1 degree from a UTM-30LX are -90 to 90 degrees in clusters of 4.
    """

    port: str  # device path, or tcp://192.168.0.10:10940
    baud: int = 19200  # of RS232 models as delivered; USB and Ethernet ignore it (section 4.6)
    angle_min: float = -math.pi  # rad, first bearing wanted; the sensor's own limit binds
    angle_max: float = math.pi  # rad, last bearing wanted
    cluster: int = 1  # steps joined into one beam, 1 to 99
    skip: int = 0  # scans left out between two, 0 to 9
    intensity: bool = False  # ask for intensities (ME) as well: they reach the raw log only
    short_codes: bool = False  # two characters a range (MS), up to 4095 mm: for slow lines
    reach_m: float = math.inf  # m, farther is reported as inf; DMAX is a limit anyway
    sync_rounds: int = 10  # round trips of TM1, 0 for none
    reply_s: float = 0.5  # s for an answer
    silence_s: float = 1.0  # s without a scan until the sensor is gone; ten scans at least
    first_scan_s: float = 10.0  # s from the command to the first scan: its motor spins up
    attempts: int = 4  # tries of QT at each speed

    def __post_init__(self) -> None:
        """Refuse what SCIP cannot express."""
        if not 0 <= self.cluster <= 99 or not 0 <= self.skip <= 9 or self.attempts < 1:
            raise ValueError("need cluster 0 to 99, skip 0 to 9 and attempts over 0")
        if self.angle_min >= self.angle_max or self.reach_m <= 0.0:
            raise ValueError("need angle_min < angle_max and a positive reach")
        if self.intensity and self.short_codes:
            raise ValueError("intensities come with three-character ranges only")

    def request(self, sensor: SensorParameters) -> ScanRequest:
        """Return the scan command for a sensor with these parameters."""
        symbol: ScanSymbol = "ME" if self.intensity else "MS" if self.short_codes else "MD"
        start, end = sensor.nearest_step(self.angle_min), sensor.nearest_step(self.angle_max)
        return ScanRequest(symbol, start, end, max(self.cluster, 1), self.skip)


class Hokuyo:
    """One sensor; everything happens in `connect`, `poll` and `close`, in the caller's thread."""

    device: Literal["laser"] = "laser"

    def __init__(
        self,
        config: HokuyoConfig,
        sink: Sink,
        clock: Clock | None = None,
        opener: Callable[[str, int], Port] = open_port,
    ) -> None:
        self.decoder = HokuyoDecoder(config.reach_m)
        self._config, self._sink, self._opener = config, sink, opener
        self._cancelled = threading.Event()
        self._clock = clock or steady_utc()
        self._connection: Connection[Reply] | None = None
        self._request: ScanRequest | None = None
        self._baud = config.baud
        self._heard_ns = 0
        self._checks_since_ns: int | None = None  # the sensor checks itself
        self._oddity = ""  # what it answers instead of scans, in words
        self._silence_ns = round(config.silence_s * 1e9)

    def connect(self) -> str:
        """Open the port and bring the sensor to streaming; returns who it is.

        A sensor that is still streaming since the link broke is taken up as it is.

        Raises:
            PortError, LinkLost: about the port.
            NoReply: if nothing answers like a Hokuyo, or no scan follows.
            WrongDevice: if it does not state its parameters.
            Refused: if it does not want to scan, with its reason.
        """
        self._open()
        if self._request is not None and self._await_scan(0.3):
            return self._begun("resumed")
        sensor = self.identify()
        self.synchronise()
        self._request = self._config.request(sensor)
        period_s = sensor.sweep_s * (self._config.skip + 1)
        patience_s = max(self._config.silence_s, 10.0 * period_s, 3.0 * self._carried_s())
        self._silence_ns = round(patience_s * 1e9)
        self._start(self._request)
        self._await_first_scan()
        return self._begun("connected")

    def identify(self) -> SensorParameters:
        """Calm the sensor down and ask for VV, II and PP, as long as it is idle.

        It opens the port if that has not been done; raises like `connect`.
        """
        if self._connection is None:
            self._open()
        self._calm()
        for question in (b"VV", b"II"):  # for people; some sensors answer them with wrong sums
            self._ask(question, required=False)
        for _ in range(self._config.attempts):
            self._ask(b"PP", required=False)
            if self.decoder.parameters is not None:
                return self.decoder.parameters
        raise WrongDevice(f"{self._config.port} speaks SCIP but states no parameters (PP)")

    def synchronise(self) -> None:
        """Measure the clock by TM1 (section 4.3), where the sensor lets us."""
        if self._config.sync_rounds == 0:
            return
        answer = self._ask(b"TM0", required=False)
        if answer is not None and answer.status in ("00", "02"):
            for _ in range(self._config.sync_rounds):
                self._ask(b"TM1", required=False)
        self._leave_clock_mode()

    def poll(self, timeout_s: float = 0.02) -> None:
        """Read once.

        Raises:
            LinkLost: if the port is gone.
            NoReply: if scans have ceased.
            Refused: if the sensor reports a fault of its own or has stopped scanning.
        """
        for reply in self._link.receive(timeout_s):
            self._heed(reply)
        if self._clock() - self._heard_ns > self._silence_ns:
            raise self._silent(self._silence_ns * 1e-9)

    def _heed(self, reply: Reply) -> bool:
        """Take note of what stands where a scan is expected; returns whether it is a scan.

        Raises:
            Refused: if it is a fault.
        """
        if decode_request(reply.echo) is None:
            return False
        if reply.status in ("00", "99"):
            if self._checks_since_ns is not None and reply.status == "99":
                self._notify("notice", "sensor has checked itself and scans again")
            self._heard_ns, self._checks_since_ns, self._oddity = reply.stamp_ns, None, ""
            return reply.status == "99"
        self._oddity = reply.status_name
        number = int(reply.status) if reply.status.isdigit() else 0
        if 50 <= number <= 97:
            raise Refused(f"the laser reports: {reply.status_name}.{self._own_words()}")
        if 21 <= number <= 49:  # section 4.2: it will go on by itself
            if self._checks_since_ns is None:
                self._checks_since_ns = reply.stamp_ns
                self._notify("notice", reply.status_name)
            if reply.stamp_ns - self._checks_since_ns <= _SELF_CHECK_S * 1e9:
                self._heard_ns = reply.stamp_ns
        return False

    def _silent(self, seconds: float) -> NoReply:
        instead = f"; it answers instead: {self._oddity}" if self._oddity else ""
        return NoReply(f"no scan from the laser for {seconds:.1f} s{instead}")

    def _notify(self, kind: EventKind, detail: str) -> None:
        now = self._clock()
        self._sink(Received(now, DeviceEvent(now, self.device, kind, detail)))

    def close(self) -> None:
        """Switch the laser off and let go of the port."""
        self._cancelled.clear()
        try:
            if self._connection is not None:
                self._ask(b"QT", required=False)
        except LinkLost:
            pass  # whom should we tell
        self.drop()

    def cancel(self) -> None:
        """Make a `connect` that is under way in another thread end with `Stopped`."""
        self._cancelled.set()

    def drop(self) -> None:
        """Let go of the port without a word."""
        if self._connection is not None:
            self._connection.port.close()
            self._connection = None

    @property
    def _link(self) -> Connection[Reply]:
        if self._connection is None:
            raise LinkLost("not connected")
        return self._connection

    def _open(self) -> None:
        port = self._opener(self._config.port, self._baud)
        self._connection = Connection(
            self.device, port, self.decoder, self._sink, self._clock, self._cancelled
        )

    def _begun(self, how: str) -> str:
        self._heard_ns = self._clock()
        product = self.decoder.version.get("PROD", "Hokuyo")
        serial = self.decoder.version.get("SERI", "unknown")
        return f"{how}: {product}, serial {serial}, on {self._config.port}"

    def _carried_s(self) -> float:
        """Return how long one scan is on the line, 0 if the sensor states no baud rate (SBPS)."""
        speed = re.match(r"(\d+)\[bps\]", self.decoder.state.get("SBPS", ""))
        if speed is None or self._request is None:
            return 0.0
        columns = 2 if self._request.with_intensity else 1
        return 10.0 * self._request.values * self._request.characters * columns / int(speed[1])

    def _own_words(self) -> str:
        """Stop the sensor and ask what it says of its fault; empty if it does not answer."""
        if self._ask(b"QT", required=False) is None:
            return ""
        self._link.drain(0.14, 0.5)
        if self._ask(b"II", required=False) is None or not self.decoder.state.get("STAT"):
            return ""
        return f" Its own words, asked after that: {self.decoder.state['STAT']}"

    def _calm(self) -> None:
        """End whatever the sensor is doing: streaming, keeping time, or SCIP 1.1 (section 6)."""
        others = [baud for baud in _BAUDS if baud != self._baud]
        bauds = [self._baud, *others] if self._link.port.has_baud else [self._baud]
        for baud in bauds:
            self._link.port.set_baud(baud)
            if self._is_calm(self._config.attempts if baud == bauds[0] else 1):
                self._baud = baud
                self._link.drain(0.14, 1.0)  # urg_library's 140 ms
                return
        raise NoReply(
            f"no Hokuyo answers on {self._config.port}. Is this the port of the laser, and is it "
            "powered (its lamp lights steadily when it is ready, up to 30 s after power-on; "
            "blinking means a fault)?"
        )

    def _is_calm(self, tries: int) -> bool:
        """Try QT until it works; give up after so many tries without any answer."""
        for attempt in range(max(tries, self._config.attempts)):
            self._link.send(b"\n")  # ends a half line that an earlier client left
            answer = self._ask(b"QT", required=False)
            if answer is None:
                if attempt + 1 >= tries:
                    return False
            elif answer.status in ("00", "02"):
                return True
            else:
                # An old URG starts in SCIP 1.1; others may have been left in clock mode.
                self._ask(b"SCIP2.0" if answer.status == "E" else b"TM2", required=False)
        return False

    def _ask(self, line: bytes, *, required: bool = True) -> Reply | None:
        """Send a command and wait for its echo; scans may come in between.

        Raises:
            NoReply: if an answer is required and none comes.
        """
        self._link.send(line + b"\n")
        for reply in self._link.receive_for(self._config.reply_s):
            if reply.echo == line:
                return reply
        if required:
            raise NoReply(f"the laser on {self._config.port} does not answer {line.decode()}")
        return None

    def _leave_clock_mode(self) -> None:
        """A sensor left in clock mode refuses everything else."""
        for _ in range(self._config.attempts):
            answer = self._ask(b"TM2", required=False)
            if answer is not None:
                return

    def _start(self, request: ScanRequest) -> None:
        for _ in range(self._config.attempts):
            self._link.send(request.encode() + b"\n")
            for reply in self._link.receive_for(max(self._config.reply_s, 1.0)):
                if not request.is_answered_by(reply.echo):
                    continue
                if reply.status in ("00", "99"):
                    return
                raise Refused(f"the laser will not scan: {reply.status_name}.{self._own_words()}")
            self._ask(b"QT", required=False)
        raise NoReply(f"the laser on {self._config.port} does not answer {request.encode()!r}")

    def _await_first_scan(self) -> None:
        """Be patient until the motor turns and the sensor has checked itself.

        Raises:
            NoReply: if no scan comes.
            Refused: if the sensor reports a fault.
        """
        patience_s = max(self._config.first_scan_s, self._silence_ns * 1e-9)
        self._heard_ns, self._oddity = self._clock(), ""
        while self._clock() - self._heard_ns < patience_s * 1e9:
            for reply in self._link.receive_for(0.1):
                if self._heed(reply):
                    return
        raise self._silent(patience_s)

    def _await_scan(self, seconds: float) -> bool:
        request = self._request
        return request is not None and any(
            request.is_answered_by(reply.echo) and reply.status == "99"
            for reply in self._link.receive_for(seconds)
        )
