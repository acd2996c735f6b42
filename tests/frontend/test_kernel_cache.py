"""Compiled kernels are those of the sources as they are, whatever changed and wherever they lie."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from slam.frontend import kernel_cache
from slam.frontend.kernel_cache import KEPT, cache_folder, kernel_sources, source_key

FRONTEND = Path(__file__).parents[2] / "frontend"
PROBE = """
from slam.frontend.compiled import kernel
from slam.frontend.degeneracy import weak_direction

@kernel
def larger(x):
    return weak_direction(x, 0.0, 2.0 * x)[1]

if __name__ == "__main__":
    from slam.frontend.probe import larger
    print(larger(1.0), sum(larger.stats.cache_hits.values()), larger.stats.cache_path)
"""


@pytest.fixture
def copy(tmp_path):
    """A copy of the sources in a package of its own, with a kernel that calls another file."""
    folder = tmp_path / "slam" / "frontend"
    shutil.copytree(FRONTEND, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder.parent / "__init__.py").touch()
    (folder / "probe.py").write_text(PROBE)
    return folder


def run_probe(folder, **environment):
    """The kernel's result, how often the cache served it, and the cache's folder."""
    path = str(folder.parents[1])
    variables = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-m", "slam.frontend.probe"], cwd=path, check=True, text=True,
        capture_output=True, env={**variables, "PYTHONPATH": path, **environment},
    )  # fmt: skip
    assert not done.stderr
    value, hits, kept = done.stdout.split()
    return float(value), int(hits), kept


def edit(path, old, new):
    """Change a source, but not the time at which it says it was changed."""
    text, times = path.read_text(), path.stat()
    assert old in text
    path.write_text(text.replace(old, new))
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def test_a_change_in_a_function_that_a_kernel_calls_is_not_missed(copy):
    assert run_probe(copy)[:2] == (2.0, 0)
    value, hits, kept = run_probe(copy)
    assert (value, hits) == (2.0, 1)
    assert kept.startswith(str(copy / "__pycache__"))
    edit(
        copy / "degeneracy.py", "return half - root, half + root,", "return half - root, 7.0 + xx,"
    )
    assert run_probe(copy)[:2] == (8.0, 0)


def test_what_cannot_be_written_is_no_error(copy, tmp_path):
    (copy / "__pycache__").touch()  # no folder can be made there
    home = {"XDG_CACHE_HOME": str(tmp_path / "home")}
    assert run_probe(copy, **home)[2].startswith(str(tmp_path / "home"))
    nowhere = {"XDG_CACHE_HOME": "/dev/null/none", "HOME": "/dev/null"}
    assert run_probe(copy, **nowhere) == (2.0, 0, "None")


def test_a_folder_that_the_user_names_is_the_only_one(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel_cache.NUMBA, "CACHE_DIR", str(tmp_path / "mine"))
    assert cache_folder.__wrapped__().parent == tmp_path / "mine"
    monkeypatch.setattr(kernel_cache.NUMBA, "CACHE_DIR", "/dev/null/none")
    assert cache_folder.__wrapped__() is None


def test_each_source_of_a_kernel_counts_and_no_other(copy):
    key = source_key(copy)
    assert source_key(FRONTEND) != key  # for the probe
    counted = set(kernel_sources(copy))
    assert {"compiled", "degeneracy", "match_arrays", "psm", "align_kernels"} <= counted
    assert "matching" not in counted
    for path in copy.glob("*.py"):
        text = path.read_text()
        path.write_text(text + "# changed\n")
        assert (source_key(copy) != key) == (path.stem in counted), path.name
        path.write_text(text)


def test_kernels_are_made_of_nothing_outside_this_folder():
    """And import in the one form that `kernel_sources` follows."""
    for name, text in kernel_sources(FRONTEND).items():
        for line in re.findall(r"^.*import\b.*$", text.decode(), re.MULTILINE):
            if "slam" in line.split() or re.search(r"\bslam\.|from \.", line):
                assert re.match(r"from slam\.frontend\.\w+ import ", line), f"{name}: {line}"


def test_folders_of_old_sources_go_when_there_is_a_new_one(monkeypatch, tmp_path):
    monkeypatch.setattr(kernel_cache.NUMBA, "CACHE_DIR", str(tmp_path))
    old = [tmp_path / f"kernels-{k}" for k in range(KEPT + 2)]
    for age, folder in enumerate(old):
        (folder / "inside").mkdir(parents=True)
        os.utime(folder, (1e9 - age, 1e9 - age))
    (tmp_path / "else").mkdir()
    new = cache_folder.__wrapped__()
    assert set(tmp_path.iterdir()) == {new, tmp_path / "else", *old[:KEPT]}
