"""Work shared out over threads; outcomes come in the order of the items.

For work that is done in compiled kernels, which need not hold the interpreter's lock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from slam.runs.machine import usable_cores

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

_AHEAD = 2  # items a thread that are waiting, so that none is idle
_MOST = 4  # threads: one more makes all items, and more than these could not be kept busy


def thread_count() -> int:
    """How many threads are worth their while here."""
    return min(usable_cores(), _MOST)


def with_outcomes(
    items: Iterable[Item], work: Callable[[Item], Outcome], threads: int = 1
) -> Iterator[tuple[Item, Outcome]]:
    """Yield each item with what `work` makes of it; equal for any number of threads.

    Args:
        items: are made by the caller's thread, a few ahead.
        work: must not depend on the items before, nor change anything.
        threads: with 1, everything is done by the caller's.

    Raises:
        Exception: what `work` or the items raised, at its item.
    """
    if threads == 1:
        yield from ((item, work(item)) for item in items)
        return
    waiting: deque[tuple[Item, Future[Outcome]]] = deque()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="batch")
    try:
        for item in items:
            waiting.append((item, pool.submit(work, item)))
            if len(waiting) > _AHEAD * threads:
                item, future = waiting.popleft()
                yield item, future.result()
        while waiting:
            item, future = waiting.popleft()
            yield item, future.result()
    finally:
        pool.shutdown(cancel_futures=True)
