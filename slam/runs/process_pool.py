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
from itertools import islice
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from slam.runs.machine import ENDING_SIGNALS

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

_STRIPE = 32  # items in a row that one process works on
_MOST = 4  # processes: each reads all items, so that more and more of the work is done twice


def usable_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def worker_count() -> int:
    """How many processes are worth their while here: one where a process cannot be copied."""
    copies = "fork" in multiprocessing.get_all_start_methods()
    return min(usable_cores(), _MOST) if copies else 1


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
    copies: list[_Copy[Item, Outcome]] = []
    try:
        for turn in range(1, processes):
            copies.append(_Copy(items, work, turn, processes, [c.receiver for c in copies]))
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
        processes: int, others: list[Connection],
    ) -> None:  # fmt: skip
        context = multiprocessing.get_context("fork")
        self._work = work
        self._made: deque[Outcome] = deque()
        self.receiver, sender = context.Pipe(duplex=False)
        share = _share(items, turn, processes)
        receivers = [*others, self.receiver]
        self._process = context.Process(
            target=_work_on, args=(share, work, sender, receivers), daemon=True
        )
        # A signal between the fork and the note of it would leave a copy that nobody knows of.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, set(ENDING_SIGNALS))
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        sender.close()

    def outcome(self, item: Item) -> Outcome:
        """The next outcome; the work is done here if the copy has come to an end."""
        if not self._made:
            try:
                self._made.extend(self.receiver.recv())
            except (EOFError, OSError):
                return self._work(item)
        return self._made.popleft()

    def end(self) -> None:
        """Let the copy go, whether it is done or not."""
        self.receiver.close()
        self._process.kill()  # it owns nothing that would have to be put away
        self._process.join()


def _share(items: Callable[[], Iterable[Item]], turn: int, processes: int) -> Iterator[Item]:
    """Yield the items of one copy."""
    for number, item in enumerate(items()):
        if number // _STRIPE % processes == turn:
            yield item


def _work_on(
    share: Iterator[Item], work: Callable[[Item], Any], sender: Connection,
    receivers: list[Connection],
) -> None:  # fmt: skip
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that was copied ends this one
    for number in set(ENDING_SIGNALS) - {signal.SIGINT}:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, set(ENDING_SIGNALS))
    for receiver in receivers:  # or this copy would wait for itself when the other end is gone
        receiver.close()
    try:
        while made := [work(item) for item in islice(share, _STRIPE)]:
            sender.send(made)
    except Exception:
        return  # the process that was copied does the same, and tells what is wrong
