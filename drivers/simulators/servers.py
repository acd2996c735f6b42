"""Simulated devices for other programs: behind pseudo-terminals and TCP ports, in real time."""

from __future__ import annotations

import math
import os
import select
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from slam.drivers.simulators.link import Line

_TICK_S = 0.001  # s between looks at the devices
_AT_ONCE = 65536  # bytes
_WAITING = 1 << 18  # bytes kept for a client that does not read
_BAUDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit()
}


class Endpoint(Protocol):
    """Where clients find a simulated device."""

    @property
    def name(self) -> str:
        """What a client opens."""
        ...

    def service(self, now_s: float) -> None:
        """Move bytes both ways at a time of simulation."""
        ...

    def prepare(self) -> None:
        """Get the device ready; called before time begins."""
        ...

    def descriptors(self) -> list[int]:
        """What to wait for."""
        ...

    def close(self) -> None:
        """Take the device away."""
        ...


class PtyEndpoint:
    """A device behind a pseudo-terminal; after a replug it has another number.

    `alias`, a path, always links to it, as udev's /dev/serial/by-id does.  The speed that
    the client sets counts: at a wrong one it reads garbage.  What the device sends while nobody
    has the port open is lost, as with a real one.
    """

    def __init__(self, line: Line, alias: Path | None = None) -> None:
        self._line, self._alias = line, alias
        self._master = -1
        self._watched = False  # whether a client has the port open
        self._unsent = b""
        self._device = ""
        self._plug()

    @property
    def name(self) -> str:
        """The alias if there is one, else the device path of the moment."""
        return str(self._alias) if self._alias else self._device

    @property
    def device(self) -> str:
        """The device path of the moment."""
        return self._device

    def service(self, now_s: float) -> None:
        """See `Endpoint`."""
        if not self._line.plugged(now_s):
            self.close()
            self._line.to_host(now_s, self._line.device.baud)  # time passes for it all the same
            return
        if self._master < 0:
            self._plug()
        baud = self._baud()
        try:
            data = _read(lambda: os.read(self._master, _AT_ONCE))
        except OSError:  # EIO: nobody has opened it
            self._nobody(now_s, baud)
            return
        if not self._watched:
            self._watched = True
            self._line.forget()
        if data:
            self._line.to_device(data, now_s, baud)
        self._unsent = (self._unsent + self._line.to_host(now_s, baud))[-_WAITING:]
        if self._unsent:
            try:
                self._unsent = self._unsent[os.write(self._master, self._unsent) :]
            except BlockingIOError:
                pass  # the client does not read; try again

    def _nobody(self, now_s: float, baud: int) -> None:
        """Let time pass for the device; what it sends, and what nobody has read, is lost."""
        self._line.to_host(now_s, baud)
        if self._watched:
            self._watched, self._unsent = False, b""
            slave = os.open(self._device, os.O_RDWR | os.O_NOCTTY)
            termios.tcflush(slave, termios.TCIFLUSH)
            os.close(slave)

    def prepare(self) -> None:
        """See `Endpoint`."""
        self._line.device.prepare()

    def descriptors(self) -> list[int]:
        """See `Endpoint`; a port that nobody has open would wake its waiter at once."""
        return [self._master] if self._master >= 0 and self._watched else []

    def close(self) -> None:
        """Pull the plug."""
        if self._master >= 0:
            os.close(self._master)
            self._master, self._watched = -1, False
            self._unsent = b""
            if self._alias and self._alias.is_symlink() and self._is_ours(self._alias):
                self._alias.unlink(missing_ok=True)

    def _is_ours(self, alias: Path) -> bool:
        """Whether the name still is this device's; another simulator may have taken it over."""
        return str(alias.readlink()) == self._device

    def _plug(self) -> None:
        self._master, slave = os.openpty()
        tty.setraw(slave)  # stays as long as the master is open
        os.set_blocking(self._master, False)
        self._device = os.ttyname(slave)
        os.close(slave)
        if self._alias:
            self._alias.unlink(missing_ok=True)
            self._alias.symlink_to(self._device)

    def _baud(self) -> int:
        return _BAUDS.get(termios.tcgetattr(self._master)[5], 0)


class TcpEndpoint:
    """A device at a TCP port of this machine; one client at a time, as Hokuyos have it."""

    def __init__(self, line: Line, port: int = 0) -> None:
        """Listen on `port`, 0 for any that is free."""
        self._line = line
        self._client: socket.socket | None = None
        self._unsent = b""
        self._listener: socket.socket | None = None
        self._port = self._listen(port)

    @property
    def name(self) -> str:
        """The address as the drivers want it."""
        return f"tcp://127.0.0.1:{self._port}"

    @property
    def port(self) -> int:
        """The number of the TCP port."""
        return self._port

    def service(self, now_s: float) -> None:
        """See `Endpoint`."""
        if not self._line.plugged(now_s):
            self.close()
        elif self._listener is None:
            self._listen(self._port)
        self._accept()
        client, baud = self._client, self._line.device.baud
        if client is not None:
            try:
                data = _read(lambda: client.recv(_AT_ONCE))
            except OSError:
                data = b""
            if data is None:
                pass
            elif data:
                self._line.to_device(data, now_s, baud)
            else:
                self._hang_up()
        self._unsent = (self._unsent + self._line.to_host(now_s, baud))[-_WAITING:]
        if self._client is None:
            self._unsent = b""
        elif self._unsent:
            try:
                self._unsent = self._unsent[self._client.send(self._unsent) :]
            except BlockingIOError:
                pass  # the client does not read; try again
            except OSError:
                self._hang_up()

    def prepare(self) -> None:
        """See `Endpoint`."""
        self._line.device.prepare()

    def descriptors(self) -> list[int]:
        """See `Endpoint`."""
        return [s.fileno() for s in (self._listener, self._client) if s is not None]

    def close(self) -> None:
        """Pull the plug."""
        self._hang_up()
        if self._listener is not None:
            self._listener.close()
            self._listener = None

    def _listen(self, port: int) -> int:
        self._listener = socket.create_server(("127.0.0.1", port), backlog=1)
        self._listener.setblocking(False)
        return int(self._listener.getsockname()[1])

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            client, _ = self._listener.accept()
        except BlockingIOError:
            return
        if self._client is not None:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client, self._unsent = client, b""
        self._line.forget()

    def _hang_up(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
            self._line.device.client_left()


def _read(read: Callable[[], bytes]) -> bytes | None:
    """Return what a call that must not wait has read, None if there was nothing."""
    try:
        return read()
    except BlockingIOError:
        return None


class SimulatorServer:
    """Runs simulated devices in a thread; all of them share one time.  A context manager."""

    def __init__(
        self, endpoints: Sequence[Endpoint], speed: float = 1.0, most_step_s: float = math.inf
    ) -> None:
        """Let simulated time run `speed` times as fast as the wall's.

        It goes on by `most_step_s` at most from one look at the devices to the next: a machine
        that is held up then loses time, and `began_ns` its meaning, where devices would else
        send all that is due at once.
        """
        self._endpoints, self._speed = tuple(endpoints), speed
        self._most_step_s, self._held_up_s = most_step_s, 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulators", daemon=True)
        self._began = time.monotonic()

    @property
    def now_s(self) -> float:
        """Seconds of simulation."""
        return (time.monotonic() - self._began) * self._speed - self._held_up_s

    @property
    def began_ns(self) -> int:
        """UTC of time zero, ns, by the clock that the drivers use."""
        return time.time_ns() - time.monotonic_ns() + round(self._began * 1e9)

    def __enter__(self) -> SimulatorServer:
        for endpoint in self._endpoints:
            endpoint.prepare()
        self._began = time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Take the devices away."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        before_s = 0.0
        while not self._stop.is_set():
            waiting = [fd for endpoint in self._endpoints for fd in endpoint.descriptors()]
            select.select(waiting, [], [], _TICK_S)
            self._held_up_s += max(0.0, self.now_s - before_s - self._most_step_s)
            for endpoint in self._endpoints:
                before_s = self.now_s
                endpoint.service(before_s)
        for endpoint in self._endpoints:
            endpoint.close()
