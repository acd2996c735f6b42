"""The same function over many items, here or on worker processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def spread(
    function: Callable[[Item], Outcome], items: Sequence[Item], workers: int = 0
) -> list[Outcome]:
    """Outcomes in the order of the items; without workers they are computed here, one by one.

    Workers are processes of this machine with a thread each (extra `batch`); function and
    items reach them by pickle.

    Raises:
        Exception: what the function raised for the first item that it raised for.
    """
    if not workers:
        return [function(item) for item in items]
    from slam.experiments.batch.engine import engine, run_tasks

    with engine(workers) as client:
        found = dict(run_tasks(client, function, items))
    outcomes: list[Outcome] = []
    for k in range(len(items)):
        outcome = found[k]
        if isinstance(outcome, Exception):
            raise outcome
        outcomes.append(outcome)
    return outcomes
