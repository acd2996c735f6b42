"""The cable to a simulated device: its speed, its faults, and an end without any hardware."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from slam.drivers.errors import LinkLost, PortError
from slam.drivers.ports import Port
from slam.drivers.simulators.drive import EPOCH_NS

Window = tuple[float, float]  # s of simulation, begin and end
_BITS_A_BYTE = 10  # 8N1
_HELD_BYTES = 1024  # what a device keeps for a line that is slower than it
_STEP_NS = 1_000_000
_LOOK_S = 0.005  # s, the longest a device is left alone: its watchdog must bite in time


class Device(Protocol):
    """A simulated device; times are seconds of simulation and never go back."""

    baud: int

    def prepare(self) -> None:
        """Do what takes long the first time, before anybody asks."""
        ...

    def client_left(self) -> None:
        """Notice, where the transport tells, that the client has closed the connection."""
        ...

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes from the client."""
        ...

    def advance(self, now_s: float) -> bytes:
        """Let time pass and return what the device sends up to then."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class WireFaults:
    """What goes wrong between device and client, in both directions; chance comes from `seed`."""

    flip_rate: float = 0.0  # share of bytes with one bit turned over
    loss_rate: float = 0.0  # share of bytes that vanish
    split: int = 0  # most bytes delivered at once, 0 for any number
    hold_s: float = 0.0  # s between deliveries, half of it to all: packets arrive merged
    delay_s: float = 0.0  # s by which what the device sends at a time is late, 0 to this
    silences: tuple[Window, ...] = ()  # nothing gets through, the port stays
    unplugged: tuple[Window, ...] = ()  # the port is gone
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse rates that are none."""
        if not (0.0 <= self.flip_rate <= 1.0 and 0.0 <= self.loss_rate <= 1.0):
            raise ValueError("rates are between 0 and 1")
        if min(self.split, self.hold_s, self.delay_s) < 0:
            raise ValueError("split, hold_s and delay_s cannot be negative")


class Line:
    """Carries bytes between a device and one client, as fast as the baud rate allows."""

    def __init__(
        self, device: Device, faults: WireFaults | None = None, *, serial: bool = True
    ) -> None:
        """Without `serial` (USB, Ethernet) bytes take no time and speeds need not agree."""
        self.device, self.serial = device, serial
        self.dropped_bytes = 0  # that the device could not keep for the slow line
        self.damaged_bytes = 0  # flipped, lost, or sent at the wrong speed
        self._faults = faults or WireFaults()
        self._rng = np.random.default_rng([self._faults.seed, 7])
        self._queue: deque[tuple[float, bytes]] = deque()  # (s when its first byte starts, data)
        self._free_s = 0.0
        self._delivered_s = -math.inf
        self._hold_s = self._faults.hold_s
        self._filled_s = 0.0

    def plugged(self, now_s: float) -> bool:
        """Whether the port exists."""
        return not _within(self._faults.unplugged, now_s)

    def unpluggings(self, now_s: float) -> int:
        """How often the plug has been pulled; a handle from before is dead for good."""
        return sum(begin <= now_s for begin, _ in self._faults.unplugged)

    def to_device(self, data: bytes, now_s: float, baud: int) -> None:
        """Carry what the client sends at its speed; it arrives at once."""
        self._fill(now_s, baud)
        if self._dead(now_s):
            self.damaged_bytes += len(data)
        else:
            self.device.receive(self._damaged(data, baud), now_s)
            self._put(self.device.advance(now_s), now_s, baud)

    def to_host(self, now_s: float, baud: int) -> bytes:
        """Return what has reached a client that listens at `baud`."""
        self._fill(now_s, baud)
        if now_s - self._delivered_s < self._hold_s:
            return b""
        ready = bytearray()
        most = self._faults.split or 1 << 18
        while self._queue and self._queue[0][0] <= now_s and len(ready) < most:
            start, data = self._queue.popleft()
            there = min(self._arrived(start, now_s, len(data)), most - len(ready))
            ready += data[:there]
            if there < len(data):
                self._queue.appendleft((start + there * self._byte_s(), data[there:]))
                break
        if ready and not (self._queue and self._queue[0][0] <= now_s):
            self._delivered_s = now_s  # pieces of one delivery follow each other at once
            if self._faults.hold_s:  # hosts keep no step with devices
                self._hold_s = self._faults.hold_s * self._rng.uniform(0.5, 1.0)
        return bytes(ready)

    def forget(self) -> None:
        """Lose what is on its way, as when a client goes."""
        self._queue.clear()
        self._free_s = 0.0

    def _dead(self, now_s: float) -> bool:
        return _within(self._faults.silences, now_s) or not self.plugged(now_s)

    def _byte_s(self) -> float:
        return _BITS_A_BYTE / self.device.baud if self.serial else 0.0

    def _arrived(self, start_s: float, now_s: float, count: int) -> int:
        if not self.serial:
            return count
        return min(count, math.floor((now_s - start_s) / self._byte_s() + 1e-6))

    def _fill(self, now_s: float, baud: int) -> None:
        """Put what the device has said since the last look on the line, each at its time."""
        while self._filled_s < now_s:
            self._filled_s = min(now_s, self._filled_s + _LOOK_S)
            self._put(self.device.advance(self._filled_s), self._filled_s, baud)

    def _put(self, data: bytes, now_s: float, baud: int) -> None:
        if not self.plugged(now_s):
            self.forget()  # what was on its way is lost with the plug
        if not data:
            return
        if self._dead(now_s):
            self.damaged_bytes += len(data)
            return
        if self.serial and (self._free_s - now_s) / self._byte_s() > _HELD_BYTES:
            self.dropped_bytes += len(data)
            return
        late = self._rng.uniform(0.0, self._faults.delay_s) if self._faults.delay_s else 0.0
        start = max(now_s + late, self._free_s)
        self._free_s = start + len(data) * self._byte_s()
        self._queue.append((start, self._damaged(data, baud)))

    def _damaged(self, data: bytes, baud: int) -> bytes:
        """Return the bytes with the faults of the line; a wrong speed spares none of them."""
        wire = np.frombuffer(data, np.uint8)
        if self.serial and baud != self.device.baud:
            self.damaged_bytes += len(wire)
            return self._rng.integers(0, 256, max(1, len(wire) // 2)).astype(np.uint8).tobytes()
        if not self._faults.flip_rate and not self._faults.loss_rate:
            return data
        flipped = self._rng.random(len(wire)) < self._faults.flip_rate
        bits = np.left_shift(1, self._rng.integers(0, 8, len(wire))).astype(np.uint8)
        kept = self._rng.random(len(wire)) >= self._faults.loss_rate
        self.damaged_bytes += int(np.count_nonzero(flipped | ~kept))
        return np.where(flipped, wire ^ bits, wire)[kept].tobytes()


def _within(windows: tuple[Window, ...], now_s: float) -> bool:
    return any(begin <= now_s < end for begin, end in windows)


class SimulatedTime:
    """Time that passes only while somebody waits; call it for UTC in ns."""

    def __init__(self) -> None:
        self.now_ns = 0  # ns of simulation

    @property
    def now_s(self) -> float:
        """Seconds of simulation."""
        return self.now_ns * 1e-9

    def __call__(self) -> int:
        """Return UTC in ns, with the simulation beginning at the epoch of the drives."""
        return EPOCH_NS + self.now_ns

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self.now_ns += round(seconds * 1e9)


class MemoryPort:
    """The client's end of a line, in the same thread and in simulated time."""

    def __init__(self, name: str, line: Line, time: SimulatedTime, baud: int) -> None:
        self.name, self.has_baud = name, line.serial
        self._line, self._time, self._baud = line, time, baud
        self._closed = False
        self._unpluggings = line.unpluggings(time.now_s)
        self._check()

    def read(self, timeout_s: float) -> bytes:
        """Wait in simulated time; see `Port`."""
        deadline = self._time.now_ns + max(0, round(timeout_s * 1e9))
        while True:
            self._check()
            data = self._line.to_host(self._time.now_s, self._baud)
            if data or self._time.now_ns >= deadline:
                return data
            self._time.now_ns = min(deadline, self._time.now_ns + _STEP_NS)

    def write(self, data: bytes) -> None:
        """See `Port`."""
        self._check()
        self._line.to_device(data, self._time.now_s, self._baud)

    def set_baud(self, baud: int) -> None:
        """See `Port`."""
        self._baud = baud

    def close(self) -> None:
        """See `Port`."""
        self._closed = True

    def _check(self) -> None:
        if self._closed or self._line.unpluggings(self._time.now_s) != self._unpluggings:
            raise LinkLost(f"{self.name} is gone")


class MemoryLink:
    """Opens memory ports on one line; a session takes it as its `opener`."""

    def __init__(self, line: Line, time: SimulatedTime) -> None:
        self.opened = 0
        self._line, self._time = line, time

    def __call__(self, name: str, baud: int) -> Port:
        """Open the port under whatever name.

        Raises:
            PortError: while it is unplugged.
        """
        if not self._line.plugged(self._time.now_s):
            raise PortError(f"{name} does not exist")
        if self.opened:  # the system keeps nothing for a port that nobody has open any more
            self._line.to_host(self._time.now_s, baud)
            self._line.forget()
        self.opened += 1
        return MemoryPort(name, self._line, self._time, baud)
