"""Work shared out over copies of the process: outcomes stay in order, whoever fails."""

import os
import signal

import pytest

from slam.forked import with_outcomes


def squared(n):
    return n * n


def with_pid(n):
    return n, os.getpid()


@pytest.mark.parametrize("processes", [1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 31, 32, 33, 200])
def test_outcomes_come_in_order(processes, count):
    found = list(with_outcomes(lambda: range(count), squared, processes))
    assert found == [(n, n * n) for n in range(count)]


def test_copies_do_their_share():
    pids = [pid for _, (_, pid) in with_outcomes(lambda: range(96), with_pid, 3)]
    assert len(set(pids)) == 3
    assert pids.count(os.getpid()) == 32


def test_a_copy_that_dies_costs_nothing():
    def work(n):
        if n == 70 and os.getpid() != this:
            os.kill(os.getpid(), signal.SIGKILL)
        return n * n

    this = os.getpid()
    found = list(with_outcomes(lambda: range(300), work, 2))
    assert found == [(n, n * n) for n in range(300)]


def test_what_the_work_raises_is_raised_at_its_item():
    def work(n):
        if n == 40:
            raise ValueError("number 40")
        return n

    outcomes = with_outcomes(lambda: range(64), work, 2)
    assert [next(outcomes)[0] for _ in range(40)] == list(range(40))
    with pytest.raises(ValueError, match="number 40"):
        next(outcomes)


def test_no_copy_is_left_when_nobody_asks_on():
    outcomes = with_outcomes(lambda: range(10**9), with_pid, 2)
    pids = {next(outcomes)[1][1] for _ in range(64)}
    copy = (pids - {os.getpid()}).pop()
    os.kill(copy, 0)  # it is there
    outcomes.close()
    with pytest.raises(ProcessLookupError):
        os.kill(copy, 0)
