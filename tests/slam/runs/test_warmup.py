"""Kernels compile in two processes; whatever becomes of the second one."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from numba import typeof
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

from slam.runs.config_file import load_config
from slam.runs.kernel_warmup.second_process import blank_scan, compiling_in_second_process
from slam.runs.kernel_warmup.simulated_room import measure_room
from slam.runs.kernel_warmup.warmup import warm_up


def test_a_blank_scan_has_arrays_of_the_kinds_that_real_ones_have():
    real = prepare(measure_room(0, 0.0), LaserExtrinsics(0, 0.0, 0.0, 0.0), ScanConfig())
    blank = blank_scan(len(real.points))
    for name, array in real._asdict().items():
        parts = array if name == "alone" else [array]
        twins = blank.alone if name == "alone" else [getattr(blank, name)]
        assert [typeof(part) for part in parts] == [typeof(twin) for twin in twins], name
        assert [np.shape(part) for part in parts] == [np.shape(twin) for twin in twins], name


def test_a_second_process_that_fails_is_not_missed(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with compiling_in_second_process():
        done = True
    assert done


def test_a_second_process_does_not_outlive_a_first_that_is_stopped(monkeypatch, tmp_path):
    sleeper = tmp_path / "sleeper"
    sleeper.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/pid\nexec sleep 60\n")
    sleeper.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(sleeper))
    with pytest.raises(KeyboardInterrupt), compiling_in_second_process():
        _stop_once_there(tmp_path / "pid")
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def _stop_once_there(path):
    while not path.exists() or not path.read_text():
        time.sleep(0.01)
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "settings",
    [["laser.max_range=2.0"], ["matcher.min_pairs=200"], ["keyframes.method=information"],
     ["matcher.method=ndt", "loops.enabled=false"]],
)  # fmt: skip
def test_no_setting_is_in_the_way_of_compiling(settings):
    warm_up(load_config(None, settings))


@pytest.mark.slow
def test_no_kernel_is_compiled_for_two_kinds_of_arrays(tmp_path):
    # On one core, in one process: two may both compile the same kernel and number it anew.
    program = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from slam.mapping.config import SlamConfig\n"
        "from slam.runs.kernel_warmup.warmup import warm_up\n"
        "warm_up(SlamConfig())"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
    compiled = [path.name for path in tmp_path.rglob("*.nbc")]
    assert any(".align-" in name for name in compiled)
    assert not [name for name in compiled if not name.endswith(".1.nbc")]
