"""From the bytes of a Hokuyo to laser scans, live and in replay alike."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

from slam.drivers.clock import ClockConfig, DeviceClock
from slam.drivers.scip_protocol import (
    Reply,
    ReplyFramer,
    decode_information,
    decode_number,
    is_sound,
)
from slam.drivers.scip_scan import (
    SCAN_SYMBOLS,
    RawScan,
    SensorParameters,
    decode_scan,
    parameters_from,
    ranges_m,
)
from slam.logs.messages import LaserScan, RawBytes, SensorMessage

_CLOCK_COMMANDS = (b"TM0", b"RS", b"RT", b"RB")  # behind these the counter has a new epoch
_WRAP_S = (1 << 24) * 1e-3  # s after which the counter starts again at 0 (section 4.3)


class HokuyoDecoder:
    """Turns raw bytes of both directions into scans; equal bytes and stamps, equal messages.

    Geometry, limits and rate are those that the sensor states in PP; a scan before that is
    counted, not guessed at.
    """

    def __init__(self, reach_m: float = math.inf, clock: ClockConfig | None = None) -> None:
        """Ranges beyond `reach_m` are reported as inf; DMAX is a limit anyway."""
        self.parameters: SensorParameters | None = None
        self.version: dict[str, str] = {}
        self.state: dict[str, str] = {}
        self.scans = 0
        self.missing = 0  # scans that the sensor's clock says there were, but nothing arrived
        self.outage = 0  # likewise, over a new start of the clock: by the times of the scans
        self.foreign = 0  # scans that another client had asked for before we did
        self.moved_stamps = 0  # of scans that would have come before the one before them
        self.lost: Counter[str] = Counter()  # replies that came but could not be used, by cause
        self.clock = DeviceClock(clock)
        self._reach_m = reach_m
        self._framer = ReplyFramer()
        self._asked_ns: int | None = None  # when TM1 was sent
        self._last_stamp: int | None = None
        self._last_count: int | None = None
        self._spoke = self._asked_scans = False  # whether this client has, since it began
        self._lost_before = 0  # replies counted in `lost` up to the last scan

    def counters(self) -> dict[str, int]:
        """What came in and what was lost, by cause."""
        return {
            "scans": self.scans,
            "missing_scans": self.missing,
            "outage_scans": self.outage,
            "foreign_scans": self.foreign,
            "skipped_bytes": self._framer.skipped_bytes,
            "moved_stamps": self.moved_stamps,
            "clock_restarts": self.clock.restarts,
            "distrusted_syncs": self.clock.distrusted_syncs,
            # A copy, because the thread that reads the device may add a cause meanwhile.
            **{f"lost_{cause}": count for cause, count in sorted(dict(self.lost).items())},
        }

    def decode(self, raw: RawBytes) -> Iterator[SensorMessage]:
        """Yield the scans that these bytes complete."""
        for item in self.accept(raw):
            if not isinstance(item, Reply):
                yield item

    def accept(self, raw: RawBytes) -> Iterator[Reply | SensorMessage]:
        """Yield every reply of the sensor, and behind it the scan it carries."""
        if raw.direction == "tx":
            self._note_command(raw)
            return
        for reply in self._framer.feed(raw.data, raw.stamp_ns):
            yield reply
            symbol = reply.symbol
            if symbol in SCAN_SYMBOLS:
                yield from self._scan(reply)
            elif symbol == "TM":
                self._synchronise(reply)
            elif symbol in ("PP", "VV", "II") and reply.status == "00":
                self._inform(symbol, reply)

    def _note_command(self, raw: RawBytes) -> None:
        self._spoke = True
        self._asked_scans |= raw.data[:2].decode("latin-1") in SCAN_SYMBOLS
        if raw.data.startswith(_CLOCK_COMMANDS):
            self.clock.restart()
            self._last_count = None
        if raw.data.startswith(b"TM1"):
            self._asked_ns = raw.stamp_ns

    def _inform(self, symbol: str, reply: Reply) -> None:
        """Take what the sensor says about itself; PP must be whole, the others are for people."""
        values, damaged = decode_information(reply.lines)
        if symbol == "VV":
            self.version = values
        elif symbol == "II":
            self.state = values
        elif damaged:
            self.lost["damaged_parameters"] += 1
        else:
            self.parameters = parameters_from(values) or self.parameters

    def _synchronise(self, reply: Reply) -> None:
        if reply.status != "00" or not reply.lines or self._asked_ns is None:
            return
        if len(reply.lines[0]) == 5 and is_sound(reply.lines[0]):
            try:
                count = decode_number(reply.lines[0][:-1])
            except ValueError:
                return
            self.clock.synchronise(count, self._asked_ns, reply.begun_ns)
            self._asked_ns = None

    def _scan(self, reply: Reply) -> Iterator[LaserScan]:
        if self.parameters is None and self._spoke and not self._asked_scans:
            self.foreign += 1  # it still streams to a client that is gone
            return
        if reply.status not in ("00", "99"):
            self.lost[f"status_{reply.status}"] += 1
            return
        if reply.status == "00" and not reply.lines:
            return  # MD says that it has understood
        raw = decode_scan(reply)
        if raw is None:
            self.lost["damaged"] += 1
        elif self.parameters is None:
            self.lost["without_parameters"] += 1
        else:
            yield from self._stamped(raw, reply, self.parameters)

    def _stamped(self, raw: RawScan, reply: Reply, sensor: SensorParameters) -> Iterator[LaserScan]:
        """Give a scan its time and its geometry."""
        request = raw.request
        if not sensor.first_step <= request.start <= request.end <= sensor.last_step:
            self.lost["damaged"] += 1
            return
        lag_ns = round(sensor.last_step * sensor.step_s * 1e9)  # it is sent when the sweep is done
        restarts = self.clock.restarts
        zero_ns = self.clock.observe(raw.timestamp, reply.begun_ns, lag_ns)
        if self.clock.restarts != restarts:
            self._last_count = None  # of another epoch: the difference says nothing
        if zero_ns is None:
            self.lost["impossible_time"] += 1
            return
        cluster = max(request.cluster, 1)
        # A cluster has no direction but its middle; its last one may be narrower than that.
        first = request.start + 0.5 * (cluster - 1)
        stamp = zero_ns + round(first * sensor.step_s * 1e9)
        if self._last_stamp is not None and stamp <= self._last_stamp:
            stamp = self._last_stamp + 1000  # the clock has been set back; order matters more
            self.moved_stamps += 1
        self._count_missing(raw, sensor, stamp)
        self._last_stamp = stamp
        self.scans += 1
        yield LaserScan(
            stamp_ns=stamp,
            angle_min=sensor.bearing(first),
            angle_step=cluster * sensor.step_rad,
            ranges=ranges_m(raw.distances, sensor, self._reach_m),
            range_min=sensor.range_min_mm * 1e-3,
            range_max=min(sensor.range_max_mm * 1e-3, self._reach_m),
            beam_period_s=cluster * sensor.step_s,
        )

    def _count_missing(self, raw: RawScan, sensor: SensorParameters, stamp_ns: int) -> None:
        """Count the scans between this one and the last that left no trace at all."""
        unusable = self.lost.total() - self._lost_before
        self._lost_before = self.lost.total()
        if raw.request.streams:
            period_s = sensor.sweep_s * (raw.request.skip + 1)
            if self._last_count is not None and self._last_stamp is not None:
                by_stamps_s = (stamp_ns - self._last_stamp) * 1e-9
                by_count_s = (raw.timestamp - self._last_count) * 1e-3
                # As many wraps as fit the stamps; a counter that was set back has lost nothing.
                passed_s = by_stamps_s + math.remainder(by_count_s - by_stamps_s, _WRAP_S)
                self.missing += max(0, round(passed_s / period_s) - 1 - unusable)
            elif self._last_stamp is not None:
                passed_s = (stamp_ns - self._last_stamp) * 1e-9
                self.outage += max(0, round(passed_s / period_s) - 1 - unusable)
        self._last_count = raw.timestamp
