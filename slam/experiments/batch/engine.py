"""Many tasks on Dask distributed: on worker processes here, or on a scheduler elsewhere."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

import dask
from dask.typing import Key
from distributed import (
    Client,
    Future,
    KilledWorker,
    LocalCluster,
    Worker,
    WorkerPlugin,
    as_completed,
)

from slam.runs.errors import RunError
from slam.runs.run_directory import version

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")

IN_FLIGHT = 200
"""Most tasks that the scheduler knows at a time: enough for any cluster's workers to stay busy."""

_ONE_THREAD = {
    f"distributed.nanny.pre-spawn-environ.{library}_NUM_THREADS": "1"
    for library in ("OMP", "MKL", "OPENBLAS", "NUMBA")
}
_PATIENCE_S = 20.0  # for a scheduler to answer, and for its first worker


class BatchError(RunError):
    """A batch cannot be run as asked; the message says what to do."""


@contextmanager
def engine(workers: int, scheduler: str | None = None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of `workers` processes that end with the block.

    Raises:
        BatchError: the scheduler does not answer, has no worker, or one of another version.
    """
    # A process a worker, since replays hold the interpreter; nothing pauses for its memory,
    # because a replay gives it back only at its end.
    settings = _ONE_THREAD | {"distributed.worker.memory.pause": False}
    with dask.config.set(settings), _quiet():
        if scheduler is None:
            with (
                LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True,
                    dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
                ) as cluster,
                Client(cluster) as client,
            ):  # fmt: skip
                client.register_plugin(_LeavesInterruptsToUs())
                yield client
        else:
            with _connected(scheduler) as client:
                _check_workers(client, scheduler)
                yield client


def run_tasks(
    client: Client, function: Callable[[Item], Outcome], items: Sequence[Item]
) -> Iterator[tuple[int, Outcome | Exception]]:
    """Run `function` on every item; yields index and result, or error, in the order they end.

    Function and items travel to the workers by pickle, so the function must belong to a module
    that they can import.  A task whose worker dies is run again elsewhere, up to three times.

    Raises:
        BatchError: the scheduler was lost.
    """
    waiting = enumerate(items)
    indices: dict[Key, int] = {}
    ended = as_completed(loop=client.loop)

    def submit(count: int) -> None:
        for index, item in islice(waiting, count):
            future = client.submit(function, item, pure=False)
            indices[future.key] = index
            ended.add(future)

    submit(IN_FLIGHT)
    for future in ended:
        result = _outcome(future)
        index = indices.pop(future.key)
        future.release()
        submit(1)
        yield index, result


def _outcome(future: Future[Any]) -> Any:
    if future.status == "finished":
        return future.result()
    if future.status != "error":
        raise BatchError("the scheduler was lost; what is finished is kept: run the command again")
    error = future.exception()
    if isinstance(error, KilledWorker):
        return BatchError("its workers died of it, again and again: out of memory?")
    return error


class _LeavesInterruptsToUs(WorkerPlugin):
    """A terminal sends Ctrl-C to the workers too; they are ended by who started them."""

    def setup(self, worker: Worker) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _connected(scheduler: str) -> Iterator[Client]:
    try:
        client = Client(scheduler, timeout=_PATIENCE_S)
    except (TimeoutError, OSError, ValueError) as error:
        raise BatchError(
            f"{scheduler}: no scheduler answers there: start one with `dask scheduler`"
        ) from error
    with client:
        yield client


def _check_workers(client: Client, scheduler: str) -> None:
    """One version on all workers, or results would depend on who made them."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError as error:
        raise BatchError(
            f"{scheduler}: the scheduler has no worker: start some with "
            f"`dask worker {scheduler} --nthreads 1`"
        ) from error
    for worker, found in client.run(version, on_error="return").items():
        if isinstance(found, Exception):
            raise BatchError(f"{worker}: the worker cannot run this program: {found}")
        if found != version():
            raise BatchError(f"{worker}: the worker has version {found}, here is {version()}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Dask's own log off the terminal: what matters of it comes as errors."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)
