"""`slam tune` as people run it: the same result for any number of workers, and after a break."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from slam.runs.config_file import load_config
from slam.tools.simulate import simulate_log

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOT = Path(__file__).parents[3]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
SEARCH = [
    *("--param", "keyframes.weights.1=0.1:10:log", "--param", "keyframes.max_interval=0.3:1"),
    *("--objective", "matches", "--against", "keyframes.method=constant"),
    *("--trials", "6", "--seed", "5"),
]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for seed in range(3):
        simulate_log("testbed-180cm", folder / f"drive{seed}.mcap", seed, "hokuyo-181", "typical")
    return folder


def tune(logs, out, *options):
    command = [sys.executable, "-m", "slam", "tune", "--out", str(out), *SEARCH, *options]
    for name in ("drive0", "drive1"):
        command += ["--train", str(logs / f"{name}.mcap")]
    return subprocess.Popen(
        [*command, "--score", str(logs / "drive2.mcap")],
        env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(process):
    out, said = process.communicate(timeout=600)
    assert process.returncode == 0, said
    return out


def test_workers_and_interruptions_do_not_change_what_is_found(logs, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    printed = finish(tune(logs, whole, "--workers", "1"))
    broken = tune(logs, parts, "--workers", "2")
    while len(list((parts / "results").glob("*.json"))) < 5:
        assert broken.poll() is None, broken.communicate()
        time.sleep(0.05)
    broken.send_signal(signal.SIGKILL)
    broken.communicate()
    assert not (parts / "config.toml").exists()
    again = finish(tune(logs, parts, "--workers", "2"))
    assert again == printed
    for name in ("config.toml", "tune.json"):
        assert (parts / name).read_bytes() == (whole / name).read_bytes()
    assert "training logs: " in printed
    assert "scoring logs, which the search never saw: " in printed
    found = json.loads((whole / "tune.json").read_text())
    assert len(found["trials"]) == 6
    config = load_config(whole / "config.toml")
    assert config.sha256() == found["config_sha256"]
    wanted = found["best"]["parameters"]
    assert config.keyframes.weights[0] == wanted["keyframes.weights.1"]
    assert config.keyframes.max_interval == wanted["keyframes.max_interval"]


def test_a_log_on_both_sides_is_refused(logs, tmp_path):
    process = tune(logs, tmp_path / "out", "--score", str(logs / "drive0.mcap"), "--workers", "1")
    _, said = process.communicate(timeout=600)
    assert process.returncode == 1
    assert "the two must be different logs" in said.splitlines()[-1]
