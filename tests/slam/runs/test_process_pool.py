"""Work shared out over copies of the process: outcomes stay in order, whoever fails."""

import multiprocessing
import os
import signal
import time

import pytest

from slam.runs.process_pool import with_outcomes


def squared(n):
    return n * n


def with_pid(n):
    return n, os.getpid()


@pytest.mark.parametrize("processes", [1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 31, 32, 33, 200])
def test_outcomes_come_in_order(processes, count):
    found = list(with_outcomes(range(count), squared, processes))
    assert found == [(n, n * n) for n in range(count)]


def test_copies_do_their_share():
    def work(n):
        time.sleep(0.001)  # long enough for both copies to begin
        return os.getpid()

    pids = [pid for _, pid in with_outcomes(range(32 * 8), work, 3)]
    assert len(set(pids)) == 3
    assert pids.count(os.getpid()) == 64


def test_a_copy_that_dies_costs_nothing():
    def work(n):
        if n == 70 and os.getpid() != this:
            os.kill(os.getpid(), signal.SIGKILL)
        return n * n

    this = os.getpid()
    found = list(with_outcomes(range(300), work, 2))
    assert found == [(n, n * n) for n in range(300)]


def test_what_the_work_raises_is_raised_at_its_item():
    def work(n):
        if n == 40:
            raise ValueError("number 40")
        return n

    outcomes = with_outcomes(range(64), work, 2)
    assert [next(outcomes)[0] for _ in range(40)] == list(range(40))
    with pytest.raises(ValueError, match="number 40"):
        next(outcomes)


def test_no_copy_is_left_when_nobody_asks_on():
    outcomes = with_outcomes(range(10**9), with_pid, 2)
    pids = {next(outcomes)[1][1] for _ in range(64)}
    copy = (pids - {os.getpid()}).pop()
    os.kill(copy, 0)  # it is there
    outcomes.close()
    with pytest.raises(ProcessLookupError):
        os.kill(copy, 0)


def test_a_copy_ends_when_the_process_that_was_copied_is_killed(tmp_path):
    def drive():
        for _, (_, pid) in with_outcomes(range(10**9), with_pid, 3):
            if pid != os.getpid():
                with (tmp_path / "pids").open("a") as file:
                    file.write(f"{pid}\n")
            time.sleep(0.001)

    process = multiprocessing.get_context("fork").Process(target=drive)
    process.start()
    pids = _wait_for(lambda: _two_pids(tmp_path / "pids"))
    process.kill()
    process.join()
    _wait_for(lambda: not any(_runs(pid) for pid in pids))


def _two_pids(path):
    found = {int(line) for line in path.read_text().splitlines()} if path.exists() else set()
    return found if len(found) == 2 else None


def _runs(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().split()[2] != "Z"  # nobody may be there to bury it
    except FileNotFoundError:
        return False


def _wait_for(condition, seconds=20.0):
    until = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < until
        time.sleep(0.02)
    return found


@pytest.mark.parametrize("after_s", [0.0, 0.0005, 0.001, 0.005])
def test_a_copy_ends_however_soon_nobody_asks_on(after_s):
    outcomes = with_outcomes(range(10**9), with_pid, 2)
    next(outcomes)
    time.sleep(after_s)
    outcomes.close()
    assert not multiprocessing.active_children()
