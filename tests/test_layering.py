"""Imports point one way: between the folders at the top, and between the rooms of `slam/`."""

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("logs", "drivers", "frontend", "backend", "slam", "benchmarks")
# What each folder may import, longest prefixes of module names.
ALLOWED = {
    "logs": {"slam.logs"},
    "drivers": {"slam.drivers", "slam.logs.messages"},
    "frontend": {"slam.frontend", "slam.logs.messages"},
    "backend": {"slam.backend"},
    "slam": {"slam"},
    "benchmarks": {"slam", "benchmarks"},
}
# Rooms of `slam/` from the bottom up: each imports only from rooms above it in this list.
ROOMS = (
    "maps", "mapping", "runs", "evaluation", "viewer", "online", "experiments", "tools", "cli",
)  # fmt: skip
BELOW = ("logs", "drivers", "frontend", "backend")
# Last parts of module names: `from slam.logs import protos` imports one.
SUBMODULES = {p.stem for folder in FOLDERS for p in (ROOT / folder).rglob("*.py")}
FOREIGN = {  # what a folder must never lean on
    "logs": {"gtsam", "numba", "scipy", "matplotlib"},
    "backend": {"numba", "matplotlib", "mcap"},
    "frontend": {"matplotlib", "mcap", "serial"},
    "drivers": {"matplotlib", "mcap", "scipy"},
    "slam/mapping": {"mcap", "matplotlib", "serial", "threading", "time", "os", "pathlib"},
    "slam/maps": {"mcap", "serial", "threading", "time"},
}


def imported_modules(source: str) -> set[str]:
    """Names of all modules that a source imports, also inside functions."""
    nodes = list(ast.walk(ast.parse(source)))
    plain = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    sources = [n for n in nodes if isinstance(n, ast.ImportFrom) and n.module]
    inside = {f"{n.module}.{a.name}" for n in sources for a in n.names if a.name in SUBMODULES}
    return plain | inside | {n.module for n in sources if n.module}


def modules(folder: str) -> dict[str, set[str]]:
    """Imports of each module below a folder, by the name under which it is installed."""
    paths = sorted((ROOT / folder).rglob("*.py"))
    assert paths, f"no modules found in {ROOT / folder}"
    prefix = "" if folder.startswith(("slam", "benchmarks")) else "slam."
    return {
        prefix
        + ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(
            ".__init__"
        ): imported_modules(path.read_text())
        for path in paths
    }


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Sets of modules that import each other, by repeated removal of those that import none."""
    left = {name: {t for t in targets if t in graph} for name, targets in graph.items()}
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    return [sorted(left)] if left else []


@pytest.mark.parametrize("folder", FOLDERS)
def test_imports_point_one_way(folder):
    for name, imported in modules(folder).items():
        ours = {m for m in imported if m.split(".")[0] in FOLDERS}
        wrong = {m for m in ours if not any(f"{m}.".startswith(f"{a}.") for a in ALLOWED[folder])}
        assert not wrong, f"{name} must not import {wrong}"


@pytest.mark.parametrize("folder", sorted(FOREIGN))
def test_a_folder_leans_on_no_library_that_is_not_its_business(folder):
    for name, imported in modules(folder).items():
        foreign = {m for m in imported if m.split(".")[0] in FOREIGN[folder]}
        assert not foreign, f"{name} must not import {foreign}"


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_only_from_rooms_below(room):
    allowed = {*BELOW, *ROOMS[: ROOMS.index(room) + 1]}
    for name, imported in modules(f"slam/{room}").items():
        used = {m.split(".")[1] for m in imported if m.startswith("slam.")}
        assert used <= allowed, f"{name} must not import from {used - allowed}"


def test_the_list_of_rooms_is_complete():
    found = {path.parent.name for path in (ROOT / "slam").glob("*/__init__.py")}
    assert found == set(ROOMS)
    entries = [p for p in (ROOT / "slam").iterdir() if p.name != "__pycache__"]
    assert len(entries) <= 12, sorted(p.name for p in entries)


def test_there_is_no_import_circle():
    graph: dict[str, set[str]] = {}
    for folder in FOLDERS:
        graph |= modules(folder)
    assert not circles(graph)


def test_the_message_vocabulary_needs_numpy_alone():
    imported = imported_modules((ROOT / "logs" / "messages.py").read_text())
    assert imported <= {"__future__", "dataclasses", "typing", "numpy", "numpy.typing"}


def test_the_guards_see_what_is_wrong():
    source = "def f():\n    from slam.mapping.slam import Slam"
    assert imported_modules(source) == {"slam.mapping.slam"}
    assert circles({"a": {"b"}, "b": {"a"}, "c": {"a"}}) == [["a", "b", "c"]]
    assert not circles({"a": {"b"}, "b": set()})


def test_every_folder_is_in_the_list_of_what_is_installed():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for folder in FOLDERS[:-1]
        for path in (ROOT / folder).rglob("__init__.py")
    }
    installed = {name if name.startswith("slam") else f"slam.{name}" for name in found}
    assert set(settings["packages"]) == installed
