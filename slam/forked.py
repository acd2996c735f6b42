"""Work shared out over forked copies of this process; outcomes come in the order of the items.

A copy knows all that this process knows and reads the items itself, so that only outcomes travel.
Threads would not do: half of a scan's time is spent under the interpreter's lock.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

_STRIPE = 32  # items in a row that one process works on


def usable_cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


def with_outcomes(
    items: Callable[[], Iterable[Item]], work: Callable[[Item], Outcome], processes: int = 1
) -> Iterator[tuple[Item, Outcome]]:
    """Yield each item with what `work` makes of it; equal for any number of processes.

    Args:
        items: gives them from the start, the same in each process.
        work: must not depend on the items before.
        processes: this one and its copies.  A process with other threads must not be copied.

    Raises:
        Exception: what `work` or the items raised.
    """
    copies = [_Copy(items, work, k, processes) for k in range(1, processes)]
    try:
        for number, item in enumerate(items()):
            owner = number // _STRIPE % processes
            yield item, (copies[owner - 1].outcome(item) if owner else work(item))
    finally:
        for copy in copies:
            copy.end()


class _Copy(Generic[Item, Outcome]):
    """A copy of this process that works on every so many-th stripe of the items."""

    def __init__(
        self, items: Callable[[], Iterable[Item]], work: Callable[[Item], Outcome], turn: int,
        processes: int,
    ) -> None:  # fmt: skip
        context = multiprocessing.get_context("fork")
        self._work = work
        self._made: deque[Outcome] = deque()
        self._receiver, sender = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_work_on, args=(items, work, turn, processes, sender), daemon=True
        )
        self._process.start()
        sender.close()

    def outcome(self, item: Item) -> Outcome:
        """The next outcome; the work is done here if the copy has come to an end."""
        if not self._made:
            try:
                self._made.extend(self._receiver.recv())
            except (EOFError, OSError):
                return self._work(item)
        return self._made.popleft()

    def end(self) -> None:
        """Let the copy go, whether it is done or not."""
        self._receiver.close()
        self._process.terminate()
        self._process.join()


def _work_on(
    items: Callable[[], Iterable[Any]], work: Callable[[Any], Any], turn: int, processes: int,
    sender: Connection,
) -> None:  # fmt: skip
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that was copied ends this one
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    made: list[Any] = []
    try:
        for number, item in enumerate(items()):
            if number // _STRIPE % processes != turn:
                continue
            made.append(work(item))
            if len(made) == _STRIPE:
                sender.send(made)
                made = []
        sender.send(made)
    except Exception:
        return  # the process that was copied does the same, and tells what is wrong
