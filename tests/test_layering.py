"""Imports point one way (DESIGN section 2)."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OURS = {"logs", "drivers", "frontend", "backend", "slam"}
ALLOWED = {
    "logs": {"logs"},
    "drivers": {"drivers", "logs.messages"},
    "frontend": {"frontend", "logs.messages"},
    "backend": {"backend"},
    "slam": {"slam", "logs", "drivers", "frontend", "backend"},
}
FOREIGN = {  # what a package must never lean on
    "logs": {"gtsam", "numba", "scipy", "matplotlib"},
    "backend": {"numba", "matplotlib", "mcap"},
    "frontend": {"matplotlib", "mcap", "serial"},
    "drivers": {"matplotlib", "mcap", "scipy"},
}


def imported_modules(source: str) -> set[str]:
    """Names of all modules that a source imports, also inside functions."""
    nodes = list(ast.walk(ast.parse(source)))
    plain = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    return plain | {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module}


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_imports_point_one_way(package):
    paths = sorted((ROOT / package).rglob("*.py"))
    assert paths, f"no modules found in {ROOT / package}"
    for path in paths:
        imported = imported_modules(path.read_text())
        ours = {m for m in imported if m.split(".")[0] in OURS}
        wrong = {m for m in ours if not any(f"{m}.".startswith(f"{a}.") for a in ALLOWED[package])}
        assert not wrong, f"{path} must not import {wrong}"
        foreign = {m for m in imported if m.split(".")[0] in FOREIGN.get(package, set())}
        assert not foreign, f"{path} must not import {foreign}"


def test_the_message_vocabulary_needs_numpy_alone():
    imported = imported_modules((ROOT / "logs" / "messages.py").read_text())
    assert imported <= {"__future__", "dataclasses", "typing", "numpy", "numpy.typing"}


def test_the_guard_sees_an_arrow_that_points_the_wrong_way():
    assert imported_modules("def f():\n    from slam.pipeline import Slam") == {"slam.pipeline"}
