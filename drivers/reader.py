"""The thread that a device gets: connect, read, and connect again, until told to stop."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Protocol

from slam.drivers.connection import (
    Clock,
    DeviceEvent,
    DeviceName,
    EventKind,
    Received,
    Sink,
    steady_utc,
)
from slam.drivers.errors import DriverError, Stopped


class Session(Protocol):
    """What the thread needs of `Pioneer` and `Hokuyo`."""

    @property
    def device(self) -> DeviceName:
        """Which of the two it is."""
        ...

    def connect(self) -> str:
        """Bring the device to sending; returns who it is."""
        ...

    def poll(self, timeout_s: float = ...) -> None:
        """Read once and keep the device alive."""
        ...

    def close(self) -> None:
        """Say goodbye."""
        ...

    def drop(self) -> None:
        """Let go of the port."""
        ...

    def cancel(self) -> None:
        """Call off a `connect` from outside its thread."""
        ...


class Waiter(Protocol):
    """What the thread needs of `threading.Event`; another one can make simulated time pass."""

    def is_set(self) -> bool:
        """Whether the thread shall end."""
        ...

    def set(self) -> None:
        """Ask it to."""
        ...

    def wait(self, timeout: float) -> bool:
        """Wait so many seconds at most, and return whether it shall end."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Backoff:
    """How long to wait before the next try to connect."""

    first_s: float = 0.1  # s; outages of a bad plug are short
    factor: float = 2.0  # longer each time
    most_s: float = 5.0  # s; a device that boots should not be kept waiting

    def __post_init__(self) -> None:
        """Refuse a wait that shrinks or vanishes."""
        if self.first_s <= 0.0 or self.factor < 1.0 or self.most_s < self.first_s:
            raise ValueError("need 0 < first_s <= most_s and a factor of 1 or more")

    def delay_s(self, failures: int) -> float:
        """Return the wait after so many failures in a row, 1 for the first."""
        return float(min(self.most_s, self.first_s * self.factor ** min(failures - 1, 60)))


class DeviceReader:
    """Runs one session in a thread of its own; all it shares is the sink.

    `sink` is called in that thread, in the order of receipt: `queue.SimpleQueue.put` fits.
    """

    def __init__(
        self,
        session: Session,
        sink: Sink,
        *,
        backoff: Backoff | None = None,
        clock: Clock | None = None,
        stop: Waiter | None = None,
    ) -> None:
        self.connections = 0
        self.outages = 0
        self.failures = 0  # tries to connect that failed since it last worked
        self._session, self._sink = session, sink
        self._backoff, self._clock = backoff or Backoff(), clock or steady_utc()
        self._stop = stop or threading.Event()
        self._thread = threading.Thread(target=self.run, name=session.device, daemon=True)

    def start(self) -> None:
        """Begin to connect and read."""
        self._thread.start()

    def stop(self, timeout_s: float = 15.0) -> bool:
        """Ask the thread to close the device and wait for it; False if it is still at it."""
        self._stop.set()
        self._session.cancel()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def device(self) -> DeviceName:
        """Which device it reads."""
        return self._session.device

    @property
    def running(self) -> bool:
        """Whether the thread is there."""
        return self._thread.is_alive()

    def run(self) -> None:
        """Do what the thread does; ends after `stop`."""
        while not self._stop.is_set():
            if self._connect():
                self.failures = 0
                self._read()
            self.failures += 1
            self._stop.wait(self._backoff.delay_s(self.failures))
        self._session.close()
        self._notify("closed", "on request")

    def _connect(self) -> bool:
        try:
            detail = self._session.connect()
        except Stopped:
            return False
        except DriverError as error:
            self._session.drop()
            self._notify("failed", str(error))
            return False
        self.connections += 1
        self._notify("resumed" if detail.startswith("resumed") else "connected", detail)
        return True

    def _read(self) -> None:
        """Read until told to stop or the device is lost."""
        try:
            while not self._stop.is_set():
                self._session.poll()
        except DriverError as error:
            self._session.drop()
            self.outages += 1
            self._notify("lost", str(error))

    def _notify(self, kind: EventKind, detail: str) -> None:
        now = self._clock()
        self._sink(Received(now, DeviceEvent(now, self._session.device, kind, detail)))
