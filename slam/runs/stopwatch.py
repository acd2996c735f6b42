"""Seconds per stage of a run."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from slam.mapping.stage_timer import NullTimer


class Stopwatch(NullTimer):
    """Adds up the seconds per stage; stages inside others are taken out of them."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._inner = [0.0]

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Enclose a piece of work that belongs to `stage`."""
        begin = time.perf_counter()
        self._inner.append(0.0)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - begin
            self.seconds[stage] += elapsed - self._inner.pop()
            self._inner[-1] += elapsed
