"""Batches under fire: real schedulers and workers as processes of their own, killed in mid-run."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from benchmarks.spread import spread
from slam.experiments.batch.engine import BatchError, engine, run_tasks
from slam.experiments.batch.table import is_time
from slam.tools.simulate import simulate_log

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[3]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
GRID = ["--set", "keyframes.method=constant", "--set", "keyframes.interval=0.1,0.2,0.3,0.4"]
LOGS, TASKS = 5, 20


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(LOGS):
        simulate_log("testbed-180cm", folder / f"drive{seed}.mcap", seed, "hokuyo-181", "typical")
    return folder


@pytest.fixture(scope="module")
def wanted(logs, tmp_path_factory):
    """What one local worker makes of the batch."""
    out = tmp_path_factory.mktemp("one") / "out"
    done = slam_batch(logs, out, "--workers", "1")
    said = done.communicate(timeout=600)
    assert done.returncode == 0, said
    return outcome(out)


def slam_batch(logs, out, *options):
    command = ["batch", f"{logs}/*.mcap", "--out", str(out), *GRID, *options]
    return start("slam", *command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def start(module, *arguments, **options):
    command = [sys.executable, "-m", module, *map(str, arguments)]
    return subprocess.Popen(command, env=ENVIRONMENT, start_new_session=True, **options)


def outcome(out):
    """What a batch left, but for the times."""
    table = pq.read_table(out / "table.parquet")
    kept = table.drop_columns([name for name in table.column_names if is_time(name)])
    return kept.to_pylist(), *((out / f"report.{kind}").read_bytes() for kind in ("json", "html"))


def results(out):
    """Finished tasks and when each was written."""
    return {path.name: path.stat().st_mtime_ns for path in (out / "results").glob("*.json")}


def wait_for_results(out, count, process):
    while len(results(out)) < count:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)


def gone(group, patience_s=20.0):
    """Whether a process group has no member any more, soon at least."""
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@contextmanager
def process(module, *arguments):
    """A process that is gone with all its children after the block."""
    running = start(module, *arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield running
    finally:
        with ExitStack() as stack:
            stack.callback(running.wait)
            if running.poll() is None:
                os.killpg(running.pid, signal.SIGKILL)


@contextmanager
def cluster(folder, *options):
    """A scheduler and two workers on loopback; gives its address and the workers."""
    file = folder / "scheduler.json"
    scheduler = ("--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", file)
    worker = ("--scheduler-file", file, "--nthreads", 1, "--local-directory", folder, *options)
    with (
        process("distributed.cli.dask_scheduler", *scheduler),
        process("distributed.cli.dask_worker", *worker) as first,
        process("distributed.cli.dask_worker", *worker) as second,
    ):
        while not file.exists():
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"], (first, second)


@pytest.mark.parametrize("options", [(), ("--no-nanny",)])
def test_a_worker_killed_in_mid_run_costs_time_not_results(logs, wanted, tmp_path, options):
    out = tmp_path / "out"
    with cluster(tmp_path, *options) as (address, (first, _)):
        client = slam_batch(logs, out, "--scheduler", address)
        wait_for_results(out, 4, client)
        first.kill()
        first.wait()
        assert len(results(out)) < TASKS
        said = client.communicate(timeout=600)
    assert client.returncode == 0, said
    assert outcome(out) == wanted


@pytest.mark.parametrize("local", [True, False])
def test_after_a_killed_client_only_unfinished_tasks_run(logs, wanted, tmp_path, local):
    out = tmp_path / "out"
    with ExitStack() as stack:
        if local:
            where = ("--workers", "2")
        else:
            where = ("--scheduler", stack.enter_context(cluster(tmp_path))[0])
        client = slam_batch(logs, out, *where)
        wait_for_results(out, 4, client)
        client.kill()
        client.communicate()
        time.sleep(5.0)  # tasks that were running may end
        before = results(out)
        assert 4 <= len(before) < TASKS
        again = slam_batch(logs, out, *where)
        _, said = again.communicate(timeout=600)
    assert again.returncode == 0, said
    assert f"{len(before)} of {TASKS} are there already" in said
    after = results(out)
    assert len(after) == TASKS
    assert {name: after[name] for name in before} == before
    assert outcome(out) == wanted


def test_an_interrupt_ends_all_and_leaves_no_halves(logs, tmp_path):
    out = tmp_path / "out"
    client = slam_batch(logs, out, "--workers", "2")
    wait_for_results(out, 3, client)
    os.killpg(client.pid, signal.SIGINT)  # as a terminal does
    _, said = client.communicate(timeout=120)
    assert client.returncode == 130
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "slam: interrupted; nothing half-written is left"
    assert not list((out / "results").glob(".*"))
    assert gone(client.pid)


def test_a_lost_scheduler_is_one_line(logs, tmp_path):
    out = tmp_path / "out"
    with ExitStack() as stack:
        address, _ = stack.enter_context(cluster(tmp_path))
        client = slam_batch(logs, out, "--scheduler", address)
        wait_for_results(out, 3, client)
        stack.close()
        _, said = client.communicate(timeout=300)
    assert client.returncode == 1, said
    assert "the scheduler was lost" in said.splitlines()[-1]


def die(_):
    os._exit(1)


def double(x):
    return 2 * x


def test_a_task_that_kills_its_workers_fails_alone():
    with engine(1) as client:
        assert "its workers died of it" in str(dict(run_tasks(client, die, [0]))[0])
        assert list(run_tasks(client, double, [2])) == [(0, 4)]


def test_what_is_spread_comes_back_in_order_or_fails_as_it_would_here():
    for workers in (0, 2):
        assert spread(double, [3, 1, 2], workers) == [6, 2, 4]
        with pytest.raises(TypeError):
            spread(double, [1, {}], workers)


def test_a_scheduler_that_is_not_there_is_one_line():
    with pytest.raises(BatchError, match="no scheduler answers there"):
        with engine(1, "tcp://127.0.0.1:9"):
            pass
