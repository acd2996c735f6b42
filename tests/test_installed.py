"""The wheel, installed beside foreign packages that have the names of our folders."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PARTS = ("slam", "drivers", "frontend", "backend", "logs", "pyproject.toml", "README.md", "LICENSE")
FOREIGN = ("backend", "logs", "drivers", "frontend")
BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build it from a copy: a build leaves folders behind."""
    setuptools = pytest.importorskip("setuptools", minversion="77")
    assert setuptools
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, source / part)
    subprocess.run(
        [sys.executable, "-c", BUILD, str(out)], cwd=source, check=True, capture_output=True
    )
    return next(out.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """An environment of its own: our wheel, foreign packages, and the libraries of this one."""
    home = tmp_path_factory.mktemp("env")
    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    site = next((home / "lib").glob("python*")) / "site-packages"
    subprocess.run(
        [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps",
         "--no-index", "--no-compile", "--disable-pip-version-check", str(wheel)],
        check=True, capture_output=True,
    )  # fmt: skip
    # A plain path: what is installed as editable in that folder is not found through it.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    for name in FOREIGN:
        (site / name).mkdir()
        (site / name / "__init__.py").write_text("FOREIGN = True\n")
    return home


def run(installed, *words, cwd):
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [str(installed / "bin" / words[0]), *words[1:]],
        cwd=cwd, capture_output=True, text=True, env=environment, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_one_package_is_installed_with_all_its_files(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"slam"}
    code = {
        path.relative_to(ROOT).as_posix()
        for folder in ("slam", "drivers", "frontend", "backend", "logs")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    expected = {path if path.startswith("slam/") else f"slam/{path}" for path in code}
    assert expected <= set(names)


def test_our_modules_are_ours_and_foreign_ones_stay_foreign(installed, tmp_path):
    program = (
        "import importlib, slam, slam.drivers, slam.logs, slam.frontend, slam.backend\n"
        f"foreign = [importlib.import_module(n).FOREIGN for n in {FOREIGN}]\n"
        "import slam.backend.pose_graph, slam.drivers.hokuyo, slam.mapping.slam\n"
        "print(slam.__file__, slam.drivers.hokuyo.__file__, all(foreign))"
    )
    package, module, foreign = run(installed, "python", "-c", program, cwd=tmp_path).split()
    assert package.startswith(str(installed))
    assert module.startswith(str(installed))
    assert foreign == "True"


def test_the_command_runs_in_a_folder_that_holds_the_names_of_our_parts(installed, tmp_path):
    for name in FOREIGN:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('not ours')\n")
    assert "online" in run(installed, "slam", "--help", cwd=tmp_path)
    assert "office" in run(installed, "slam", "simulate", "list", cwd=tmp_path)
    assert "sdp-slam 0." in run(installed, "slam", "--version", cwd=tmp_path)


def test_every_dependency_has_a_lower_bound_to_test_with():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needs = {
        *project["dependencies"],
        *(n for e in extras if e not in ("dev", "fuzz") for n in extras[e]),
    }
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "lowest_versions.py"), str(ROOT / "pyproject.toml")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = done.stdout.split()
    assert len(found) == len(needs)
    assert "numpy==2.0.*" in found
