"""Work shared out over threads: outcomes stay in order, whoever fails."""

import threading
import time

import pytest

from slam.runs.thread_pool import with_outcomes


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 5, 6, 7, 200])
def test_outcomes_come_in_order(threads, count):
    found = list(with_outcomes(range(count), lambda n: n * n, threads))
    assert found == [(n, n * n) for n in range(count)]


def test_threads_work_at_the_same_time():
    both = threading.Barrier(2, timeout=20.0)
    found = list(with_outcomes(range(2), lambda n: both.wait(), 2))
    assert sorted(outcome for _, outcome in found) == [0, 1]


def test_what_the_work_raises_is_raised_at_its_item():
    def work(n):
        if n == 40:
            raise ValueError("number 40")
        return n

    outcomes = with_outcomes(range(64), work, 2)
    assert [next(outcomes)[0] for _ in range(40)] == list(range(40))
    with pytest.raises(ValueError, match="number 40"):
        next(outcomes)


@pytest.mark.parametrize("after_s", [0.0, 0.001, 0.01])
def test_no_thread_is_left_when_nobody_asks_on(after_s):
    outcomes = with_outcomes(range(10**9), lambda n: n, 2)
    next(outcomes)
    time.sleep(after_s)
    outcomes.close()
    assert not [t for t in threading.enumerate() if t.name.startswith("batch")]


def test_items_are_made_only_a_few_ahead():
    made = []

    def items():
        for n in range(10**9):
            made.append(n)
            yield n

    outcomes = with_outcomes(items(), lambda n: n, 2)
    next(outcomes)
    assert len(made) <= 5
    outcomes.close()
