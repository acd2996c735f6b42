"""Commands that need no device, without what only Linux and macOS, or only Linux, offer."""

import subprocess
import sys

import pytest

from slam.runs import machine

HIDDEN = """
import os, signal, sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "resource", "termios", "pty", "tty"):
            raise ImportError(f"{name} is not there on this system")
sys.meta_path.insert(0, Hidden())
for name in ("fcntl", "resource", "termios", "pty", "tty"):
    sys.modules.pop(name, None)
del signal.SIGHUP, os.sched_getaffinity
"""


def without(words, code=HIDDEN, **options):
    """Run the command in a Python that lacks these."""
    program = f"{code}\nfrom slam.cli.main import main\nsys.argv = ['slam', *{words!r}]\nmain()"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=250, **options
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def test_logs_are_made_mapped_and_judged_without_them(tmp_path):
    log, run = str(tmp_path / "a.mcap"), str(tmp_path / "run")
    for words in (
        ["simulate", "testbed-180cm", "--out", log],
        ["info", log],
        ["replay", log, "--out", run],
        ["export", run, "--tum", str(tmp_path / "a.tum")],
    ):
        done = without(words)
        assert done.returncode == 0, (words, done.stderr)
    assert (tmp_path / "run" / "map.pgm").exists()


def test_memory_is_in_megabytes_everywhere(monkeypatch):
    here = machine.peak_memory_mb()
    assert 20 < here < 20_000
    monkeypatch.setattr(machine.sys, "platform", "darwin")  # which counts bytes, not kB
    assert machine.peak_memory_mb() == pytest.approx(here / 1024, abs=0.2)
    monkeypatch.setattr(machine, "resource", None)
    assert machine.peak_memory_mb() is None


@pytest.mark.parametrize("words", [["simulate", "list"], ["--help"]])
def test_a_reader_that_goes_early_is_no_failure_of_ours(words):
    process = subprocess.Popen(
        [sys.executable, "-m", "slam", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    process.stdout.close()
    with process.stderr as talk:
        assert talk.read() == ""
    assert process.wait(60) == 141


def test_kernels_without_a_place_to_stay_are_told_in_one_line():
    code = """
import sys
import slam.cli.app
def fail():
    raise RuntimeError("cannot cache function 'align': no locator available for file 'x'")
slam.cli.app.app = fail
"""
    done = without(["info"], code)
    assert done.returncode == 1
    assert "NUMBA_CACHE_DIR" in done.stderr
