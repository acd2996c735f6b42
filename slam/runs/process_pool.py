"""Work shared out over forked copies of this process; outcomes come in the order of the items.

Threads would not do: half of a scan's time is spent under the interpreter's lock.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any, TypeVar

from slam.runs.machine import ENDING_SIGNALS

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

_STRIPE = 32  # items in a row that one process works on: some 10 ms of work
_AHEAD = 2  # stripes a process that are waiting, so that none is idle
_MOST = 4  # processes: this one prepares all items, and more could not be kept busy
_ENDING = set(ENDING_SIGNALS)

_work: Callable[[Any], Any]  # of a copy


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
    items: Iterable[Item], work: Callable[[Item], Outcome], processes: int = 1
) -> Iterator[tuple[Item, Outcome]]:
    """Yield each item with what `work` makes of it; equal for any number of processes.

    Args:
        items: reach the copies by pickle, and so do outcomes on their way back.
        work: must not depend on the items before; copies know it as it is now.
        processes: this one and its copies.  A process with other threads must not be copied.

    Raises:
        Exception: what `work` or the items raised.
    """
    if processes == 1:
        yield from ((item, work(item)) for item in items)
        return
    source = iter(items)
    stripes = iter(lambda: list(islice(source, _STRIPE)), [])
    waiting: deque[tuple[list[Item], Future[list[Outcome]] | None]] = deque()
    with _copies(processes - 1, work) as submit:
        for number, stripe in enumerate(stripes):
            # This process prepares the items as well, so it works on fewer of them.
            waiting.append((stripe, submit(stripe) if number % (processes + 1) else None))
            if len(waiting) > _AHEAD * processes:
                yield from _done(*waiting.popleft(), work)
        while waiting:
            yield from _done(*waiting.popleft(), work)


def _done(
    stripe: list[Item], future: Future[list[Outcome]] | None, work: Callable[[Item], Outcome]
) -> Iterator[tuple[Item, Outcome]]:
    """Yield a stripe's outcomes; where a copy failed or died, the work is done here."""
    with suppress(Exception):
        if future is not None:
            yield from zip(stripe, future.result(), strict=True)
            return
    yield from ((item, work(item)) for item in stripe)


@contextmanager
def _copies(
    count: int, work: Callable[[Item], Outcome]
) -> Iterator[Callable[[list[Item]], Future[list[Outcome]] | None]]:
    """Copies of this process; gives the function that hands one of them a stripe."""
    pool = ProcessPoolExecutor(
        count, multiprocessing.get_context("fork"), initializer=_begin, initargs=(work,)
    )

    def submit(stripe: list[Item]) -> Future[list[Outcome]] | None:
        # The first call forks: a signal then would run this process's handlers in the copy.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
        try:
            return pool.submit(_work_on, stripe)
        except BrokenProcessPool:
            return None  # a copy has died
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield submit
    finally:
        pool.shutdown(cancel_futures=True)


def _begin(work: Callable[[Any], Any]) -> None:
    """Prepare a copy: it ends with the process that was copied, and by no other signal."""
    global _work
    _work = work
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that was copied ends this one
    for number in set(ENDING_SIGNALS) - {signal.SIGINT}:
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)  # nobody waits for what is under way


def _work_on(stripe: list[Any]) -> list[Any]:
    return [_work(item) for item in stripe]
