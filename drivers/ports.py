"""Opening what a device hangs on: serial ports, pseudo-terminals, TCP."""

from __future__ import annotations

import errno
import select
import socket
from typing import Protocol
from urllib.parse import urlsplit

from slam.drivers.errors import LinkLost, PortError

BAUD_DEFAULT = 9600
CONNECT_S = 2.0  # s, how long a TCP peer may take to accept (urg_library's value)


class Port(Protocol):
    """A byte stream to a device; `LinkLost` from any method means that it is gone."""

    name: str
    has_baud: bool  # whether there is a speed that both sides must agree on

    def read(self, timeout_s: float) -> bytes:
        """Return what has come in, waiting for it up to `timeout_s`; b"" if nothing did."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        ...

    def set_baud(self, baud: int) -> None:
        """Change the speed of this side."""
        ...

    def close(self) -> None:
        """Let go of the port; may be called again."""
        ...


def open_port(name: str, baud: int = BAUD_DEFAULT) -> Port:
    """Open a serial device or pseudo-terminal by path, or `tcp://host:port` (`socket://`).

    Raises:
        PortError: if that fails; the message says what to do about it.
    """
    if name.startswith(("tcp://", "socket://")):
        return _TcpPort(name)
    from slam.drivers.serial_port import SerialPort  # pyserial needs what not every system has

    return SerialPort(name, baud)


class _TcpPort:
    """A TCP connection; pyserial's own reads one byte per call, too slow for 40 scans a second."""

    has_baud = False

    def __init__(self, name: str) -> None:
        self.name = name
        try:
            parts = urlsplit(name)
            host, port = parts.hostname, parts.port
        except ValueError as error:
            raise PortError(f"{name}: {error}") from error
        if not host or not port:
            raise PortError(f"{name}: write tcp://HOST:PORT, as in tcp://192.168.0.10:10940")
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        except OSError as error:
            raise PortError(_tcp_advice(name, error)) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float) -> bytes:
        try:
            ready, _, _ = select.select([self._socket], [], [], timeout_s)
            if not ready:
                return b""
            data = self._socket.recv(65536)
        except (OSError, ValueError) as error:
            raise LinkLost(f"{self.name} is gone ({error})") from error
        if not data:
            raise LinkLost(f"{self.name} has closed the connection")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkLost(f"{self.name} is gone ({error})") from error

    def set_baud(self, baud: int) -> None:
        """Nothing to do: Ethernet has no baud rate."""

    def close(self) -> None:
        self._socket.close()


def _tcp_advice(name: str, error: OSError) -> str:
    """Say what to do about an address that does not answer."""
    if isinstance(error, ConnectionRefusedError):
        return (
            f"{name} refuses the connection. A Hokuyo serves one client at a time: is another "
            "program connected? After power-on it refuses for some seconds."
        )
    if isinstance(error, TimeoutError) or error.errno in (errno.EHOSTUNREACH, errno.ENETUNREACH):
        return (
            f"{name} does not answer. Does this machine have an address in the sensor's network "
            "(192.168.0.x with netmask 255.255.255.0, but not .10, which is the sensor's)?"
        )
    return f"{name} cannot be reached: {error}"
