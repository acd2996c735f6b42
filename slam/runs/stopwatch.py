"""Seconds per stage of a run."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import AbstractContextManager

from slam.mapping.stage_timer import NullTimer


class Stopwatch(NullTimer):
    """Adds up the seconds per stage; stages inside others are taken out of them.

    Args:
        clock: seconds, such as those of the processor.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._clock = clock
        self._open: list[tuple[str, float]] = []  # stages, each with its beginning
        self._inner = [0.0]
        self._stages: dict[str, _Stage] = {}

    def __call__(self, stage: str) -> AbstractContextManager[None]:
        """Enclose a piece of work that belongs to `stage`."""
        if stage not in self._stages:
            self._stages[stage] = _Stage(self, stage)
        return self._stages[stage]

    def begin(self, stage: str) -> None:
        """Enter a stage."""
        self._inner.append(0.0)
        self._open.append((stage, self._clock()))

    def end(self) -> None:
        """Leave the stage that was entered last."""
        stage, begin = self._open.pop()
        elapsed = self._clock() - begin
        self.seconds[stage] += elapsed - self._inner.pop()
        self._inner[-1] += elapsed


class _Stage(AbstractContextManager[None]):
    """One stage, entered for every message: a generator would take five times as long."""

    def __init__(self, watch: Stopwatch, name: str) -> None:
        self._watch, self._name = watch, name

    def __enter__(self) -> None:
        self._watch.begin(self._name)

    def __exit__(self, *error: object) -> None:
        self._watch.end()
