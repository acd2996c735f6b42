"""The console script: starts the commands, and ends them in one line whatever happens.

It loads nothing but the standard library before signals are taken care of.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import traceback
import warnings
from types import FrameType

_CLOSED = 141  # 128 + SIGPIPE: what shells give for a program whose reader has gone


class _Signalled(BaseException):
    """A signal to stop, as an exception, so that files are closed on the way out."""


_received: list[int] = []  # the signals that came, in order


def _on_signal(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    raise _Signalled


def main() -> None:
    """Entry point of the console script: known errors become one line and an exit code."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows lacks the last
        number = getattr(signal, name, None)
        if number and (name != "SIGHUP" or signal.getsignal(number) != signal.SIG_IGN):  # nohup
            signal.signal(number, _on_signal)
    stdout = _another_handle()
    warnings.showwarning = _show_warning
    try:
        # Takes a third of a second, in which a person may press Ctrl-C.
        from slam.cli.app import app

        app()
    except BaseException as error:
        # A library that was being loaded may have made another error of the signal.
        if _received:
            word = "interrupted" if _received[0] == signal.SIGINT else "terminated"
            _echo(f"slam: {word}; nothing half-written is left")
            raise SystemExit(128 + _received[0]) from None
        broken = isinstance(error, BrokenPipeError) or (
            isinstance(error, SystemExit) and error.code == 1  # what typer and rich make of it
        )
        if broken and _nobody_reads(stdout):  # `slam info LOG | head`
            sys.stdout = open(os.devnull, "w")  # for what is still to be flushed
            raise SystemExit(_CLOSED) from None
        if not isinstance(error, Exception) or not (line := _line(error)):
            raise
        from slam.cli.output import is_verbose

        if is_verbose():
            traceback.print_exception(error)
        _echo(f"slam: {line}")
        raise SystemExit(1) from error


def _show_warning(message: Warning | str, *where: object, **more: object) -> None:
    _echo(f"slam: note: {message}")


def _another_handle() -> int | None:
    """Stdout once more: rich puts something else in its place when it breaks."""
    try:
        return os.dup(sys.stdout.fileno())
    except (OSError, ValueError, AttributeError):  # it is closed, or is no file
        return None


def _nobody_reads(stdout: int | None) -> bool:
    """Whether stdout is a pipe whose reader has gone."""
    if stdout is None or not hasattr(select, "poll"):  # Windows has no such question
        return False
    watch = select.poll()
    watch.register(stdout, 0)  # errors are always told
    return any(event & select.POLLERR for _, event in watch.poll(0))


def _echo(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def _line(error: Exception) -> str:
    """What to tell the person at the terminal; empty if the error is a fault of ours."""
    if getattr(error, "explains_itself", False):
        return str(error)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}: check the disk and the permissions"
    if isinstance(error, RuntimeError) and "no locator available" in str(error):
        return (
            "compiled kernels have nowhere to stay: name a folder that you can write in the "
            "environment variable NUMBA_CACHE_DIR"
        )
    if isinstance(error, MemoryError):
        return f"not enough memory: {error or 'the log is too long or the map too fine'}"
    return ""
