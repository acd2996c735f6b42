"""What can go wrong with a device, one class for each different reaction."""

from __future__ import annotations


class DriverError(Exception):
    """Something is wrong with a device; the message says what the operator should look at."""


class PortError(DriverError):
    """The port cannot be opened: missing, forbidden or taken; the message gives the remedy."""


class LinkLost(DriverError):  # noqa: N818  # named for what happened
    """The port is gone (unplugged or switched off): reconnect and start again."""


class NoReply(DriverError, TimeoutError):  # noqa: N818  # named for what happened
    """The device did not answer in time: check power, port name and speed."""


class WrongDevice(DriverError):  # noqa: N818  # named for what happened
    """Something answered, but it is not the device that was expected there."""


class Refused(DriverError):  # noqa: N818  # named for what happened
    """The device understood a command and declined it, or reports that it is broken."""


class Stopped(DriverError):  # noqa: N818  # named for what happened
    """Nothing is wrong: waiting for a device was called off by its own program."""
