"""Recorders killed without warning, and disks cut at every byte."""

from __future__ import annotations

import os
import random
import signal
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserScan, Message, WheelOdometry
from slam.logs.recorder import Recorder
from slam.logs.recording import RecorderConfig
from slam.logs.recover import recover

GIVEN = struct.Struct("<Qd")  # number of a message, when the recorder got it
PERIOD_S = 0.008
AT_ONCE = 10  # recorders that run beside each other
LATEST_S = 1.8


@dataclass
class Trial:
    path: Path
    pid: int
    pipe: int
    dies_at: float


def message(k: int) -> Message:
    if k % 2:
        return WheelOdometry(k, float(k), 0.0, 0.0)
    return LaserScan(k, 0.0, 0.0175, np.full(181, k, dtype=np.float32))


def record_for_ever(path: Path, pipe: int, config: RecorderConfig) -> None:
    recorder = Recorder(path, {"id": "1"}, config)
    k = 0
    while True:
        recorder.put(message(k))
        os.write(pipe, GIVEN.pack(k, time.monotonic()))
        k += 1
        time.sleep(PERIOD_S)


def start(path: Path, dies_after_s: float, config: RecorderConfig) -> Trial:
    read_end, write_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            record_for_ever(path, write_end, config)
        finally:
            os._exit(1)
    os.close(write_end)
    return Trial(path, pid, read_end, time.monotonic() + dies_after_s)


def kill(trial: Trial) -> tuple[list[tuple[int, float]], float]:
    """Kill a recorder and return what it had been given, and when it died."""
    time.sleep(max(0.0, trial.dies_at - time.monotonic()))
    killed_at = time.monotonic()
    os.kill(trial.pid, signal.SIGKILL)
    _, status = os.waitpid(trial.pid, 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    with os.fdopen(trial.pipe, "rb") as pipe:
        data = pipe.read()
    return [GIVEN.unpack_from(data, i) for i in range(0, len(data), GIVEN.size)], killed_at


def saved_stamps(trial: Trial) -> list[int]:
    """Return the stamps of what can be read of all files, whole or recovered."""
    stamps = []
    for path in sorted(trial.path.parent.glob(trial.path.stem + "*")):
        source = path
        if path.suffix == ".partial":
            source = path.with_suffix(".rec")
            try:
                recover(path, source)
            except LogError:
                continue  # nothing had been synced yet
        with open_log(source) as log:
            stamps += [m.stamp_ns for m in log.messages()]
            assert not log.skipped
    return stamps


def run_trials(folder: Path, count: int, seed: int) -> list[float]:
    """Kill recorders at random instants and return for each how many seconds were lost."""
    chance, losses = random.Random(seed), []
    for first in range(0, count, AT_ONCE):
        trials = []
        for n in range(first, min(first + AT_ONCE, count)):
            config = RecorderConfig(rotate_bytes=30_000 if n % 3 == 0 else 0)
            path = folder / f"{n:03}.mcap"
            trials.append(start(path, chance.uniform(0.02, LATEST_S), config))
        trials.sort(key=lambda trial: trial.dies_at)
        ends = [kill(trial) for trial in trials]
        losses += [lost_seconds(t, *end) for t, end in zip(trials, ends, strict=True)]
    return losses


def lost_seconds(trial: Trial, given: list[tuple[int, float]], killed_at: float) -> float:
    saved = saved_stamps(trial)
    assert saved == list(range(len(saved)))  # a prefix, in order, nothing twice
    lost = [when for k, when in given if k >= len(saved)]
    return killed_at - lost[0] if lost else 0.0


def test_a_recorder_killed_at_any_instant_loses_less_than_a_second(tmp_path: Path):
    losses = run_trials(tmp_path, 20, seed=1)
    assert max(losses) < 1.0, losses
    assert max(losses) > 0.05  # the test did catch messages on their way


@pytest.mark.slow
def test_two_hundred_recorders_killed_lose_less_than_a_second_each(tmp_path: Path):
    losses = run_trials(tmp_path, 200, seed=2)
    assert max(losses) < 1.0, losses
