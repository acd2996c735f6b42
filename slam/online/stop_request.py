"""SIGINT, SIGTERM and SIGHUP as a request that is granted in good order; a second one insists.

Under `nohup` the closed terminal is ignored, as it should be.
"""

from __future__ import annotations

import signal
import time
from types import FrameType, TracebackType
from typing import Any, Self

from slam.runs.machine import ENDING_SIGNALS

_SAME_S = 1.0  # `timeout` and others signal a program and its group: that is one request


class StopRequest:
    """Use it in a `with` block, in the main thread; call it to learn whether to stop."""

    def __init__(self) -> None:
        self.number = 0  # of the signal that came, 0 if none did
        self._before: dict[int, Any] = {}
        self._came = 0.0

    @property
    def exit_code(self) -> int:
        """What a shell expects of a program that ended by that signal; 0 if none came."""
        return 128 + self.number if self.number else 0

    def __call__(self) -> bool:
        """Whether the first signal has come."""
        return self.number != 0

    def __enter__(self) -> Self:
        for number in ENDING_SIGNALS:
            ignored = signal.getsignal(number) == signal.SIG_IGN  # `nohup slam`
            if number in (signal.SIGINT, signal.SIGTERM) or not ignored:
                self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if not self.number:
            self.number, self._came = number, now
        if now - self._came < _SAME_S:
            return
        handler = self._before[number]
        if callable(handler):
            handler(number, frame)
