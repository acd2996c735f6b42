"""A serial port or pseudo-terminal, and what to do about one that does not open."""

from __future__ import annotations

import errno
import getpass
import select

import serial
from serial.tools import list_ports
from slam.drivers.errors import LinkLost, PortError

_AT_ONCE = 4096  # bytes taken from the system in one call


class SerialPort:
    """8N1 without flow control, locked against other programs (docs/devices.md, section 1.1)."""

    has_baud = True

    def __init__(self, name: str, baud: int) -> None:
        self.name = name
        try:
            self._serial = serial.serial_for_url(
                name, baudrate=baud, timeout=0, write_timeout=1.0, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise PortError(_serial_advice(name, error)) from error

    def read(self, timeout_s: float) -> bytes:
        """See `Port`."""
        try:
            ready, _, _ = select.select([self._serial.fileno()], [], [], timeout_s)
            return bytes(self._serial.read(_AT_ONCE)) if ready else b""
        except (serial.SerialException, OSError, TypeError, ValueError) as error:
            raise LinkLost(f"{self.name} is gone ({error})") from error

    def write(self, data: bytes) -> None:
        """See `Port`."""
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise LinkLost(f"{self.name} takes no more bytes") from error
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLost(f"{self.name} is gone ({error})") from error

    def set_baud(self, baud: int) -> None:
        """See `Port`."""
        try:
            self._serial.baudrate = baud
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLost(f"{self.name} does not take {baud} baud ({error})") from error

    def close(self) -> None:
        """See `Port`."""
        self._serial.close()


def _serial_advice(name: str, error: Exception) -> str:
    """Say what to do about a serial port that does not open."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        known = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return (
            f"{name} does not exist. Is the device switched on and its cable plugged in? "
            f"Ports on this machine: {known}. Numbers change on replugging; the links in "
            "/dev/serial/by-id do not."
        )
    if number == errno.EACCES or "Permission denied" in text:
        return (
            f"no permission for {name}. Serial ports belong to the group dialout: run "
            f"`sudo usermod -a -G dialout {_user()}`, then log out and in again."
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return (
            f"{name} is in use by another program. `fuser -v {name}` names it; "
            "ModemManager holds new ports for half a minute."
        )
    if "Inappropriate ioctl" in text:
        return f"{name} is no serial port."
    return f"{name} cannot be opened: {text}"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # an account without a name, as in some containers
        return "$USER"
