"""The console script: starts the commands, and ends them in one line whatever happens.

It loads nothing but the standard library before signals are taken care of.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType


class _Signalled(BaseException):
    """A signal to stop, as an exception, so that files are closed on the way out."""


_received: list[int] = []  # the signals that came, in order


def _on_signal(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    raise _Signalled


def main() -> None:
    """Entry point of the console script: known errors become one line and an exit code."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # `nohup slam`
            signal.signal(number, _on_signal)
    try:
        from slam.cli.app import (
            app,  # takes a third of a second, in which a person may press Ctrl-C
        )

        app()
    except BaseException as error:
        # A library that was being loaded may have made another error of the signal.
        if _received:
            word = "interrupted" if _received[0] == signal.SIGINT else "terminated"
            _say(f"slam: {word}; nothing half-written is left")
            raise SystemExit(128 + _received[0]) from None
        if not isinstance(error, Exception) or not (line := _line(error)):
            raise
        _say(f"slam: {line}")
        raise SystemExit(1) from error


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def _line(error: Exception) -> str:
    """What to tell the person at the terminal; empty if the error is a fault of ours."""
    if getattr(error, "explains_itself", False):
        return str(error)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}: check the disk and the permissions"
    if isinstance(error, MemoryError):
        return f"not enough memory: {error or 'the log is too long or the map too fine'}"
    return ""
