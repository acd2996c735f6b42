"""The benchmarks, which are not installed: they are where the source of the program is."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import slam
from slam.runs.errors import RunError


def load_benchmarks() -> ModuleType:
    """Return the module `benchmarks.run` of the checkout that this program runs from.

    Raises:
        RunError: the program was installed without its source tree.
    """
    root = Path(slam.__file__).parents[1]
    if not (root / "benchmarks" / "run.py").is_file():
        raise RunError(
            "slam bench: the benchmarks are not part of the installed package: "
            "get the source tree and install it with `pip install -e .`"
        )
    if str(root) not in sys.path:
        sys.path.append(str(root))  # worker processes inherit it
    return importlib.import_module("benchmarks.run")
