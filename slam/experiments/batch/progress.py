"""How far a batch is, and when it will be done: a line on stderr."""

from __future__ import annotations

import sys
import time
from datetime import timedelta

_PERIOD_S = {True: 0.5, False: 10.0}  # between two lines, on a terminal and elsewhere


class TaskProgress:
    """Counts tasks; on a terminal one line is rewritten, elsewhere there is a new one."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total = what, total
        self._done = self._failed = 0
        self._terminal = sys.stderr.isatty()
        self._began = self._told = time.monotonic()

    def tick(self, failed: bool) -> None:
        """One more is done."""
        self._done += 1
        self._failed += failed
        now = time.monotonic()
        last = self._done == self._total
        if now - self._told >= _PERIOD_S[self._terminal] or last:
            self._told = now
            erase, end = ("\r\x1b[K", "\n" if last else "") if self._terminal else ("", "\n")
            sys.stderr.write(erase + self.line(now - self._began) + end)
            sys.stderr.flush()

    def line(self, elapsed_s: float) -> str:
        """What to say after so long; the rest is taken to go as fast as what is done."""
        failed = f", {self._failed} failed" if self._failed else ""
        rest = elapsed_s / self._done * (self._total - self._done) if self._done else 0.0
        eta = f", {_clock(rest)} to go" if self._done < self._total else f" in {_clock(elapsed_s)}"
        return f"{self._what}: {self._done} of {self._total}{failed}{eta}"


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
