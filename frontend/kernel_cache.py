"""Where compiled kernels are kept: a folder that is named after everything they are made of.

Numba keeps a compiled kernel as long as the file it is defined in stays the same.  Kernels here
call functions, and use constants, of other files, whose change numba does not see.  So the folder's
name holds a hash of all sources that end up in a kernel, and of the versions of numba and numpy:
what is found in it is never stale.

Of numba this uses what is public: `numba.config.CACHE_DIR` (the variable NUMBA_CACHE_DIR).
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import __version__ as numba_version
from numba import config

NUMBA: Any = config  # its settings are made of the environment, unseen by type checkers
KEPT = 3  # folders of other sources or versions that stay, for those who switch to and fro
_PREFIX = "kernels-"
_HERE = Path(__file__).parent
_IMPORT = re.compile(rb"^from slam\.frontend\.(\w+) import", re.MULTILINE)


def kernel_sources(folder: Path) -> dict[str, bytes]:
    """Sources of all modules in `folder` with kernels, and of all that those import from it."""
    texts = {path.stem: path.read_bytes() for path in sorted(folder.glob("*.py"))}
    imports = {name: {part.decode() for part in _IMPORT.findall(texts[name])} for name in texts}
    found: set[str] = set()
    new = {name for name in texts if "compiled" in imports[name]}
    while new:
        found |= new
        new = {other for name in new for other in imports[name] if other in texts} - found
    return {name: texts[name] for name in sorted(found)}


def source_key(folder: Path) -> str:
    """Hash of all kernels in `folder` and of what compiles them."""
    versions = numba_version, np.__version__, platform.python_version(), platform.machine()
    key = hashlib.sha256(repr(versions).encode())
    for name, text in kernel_sources(folder).items():
        key.update(f"{name} {len(text)}\n".encode())
        key.update(text)
    return key.hexdigest()[:16]


@lru_cache(maxsize=1)
def cache_folder() -> Path | None:
    """The folder for kernels compiled from the sources as they are; None if none can be written.

    It lies in the folder that NUMBA_CACHE_DIR names, if it names one; else beside the
    modules, or in the user's cache where those are read only.
    """
    try:
        name = _PREFIX + source_key(_HERE)
    except OSError:
        return None  # no sources beside this module: nothing tells what a kernel is made of
    for base in _bases():
        folder = base / name
        is_new = not folder.exists()
        if _can_be_written(folder):
            if is_new:
                _remove_old(base)
            return folder
    return None


def _bases() -> Iterator[Path]:
    if NUMBA.CACHE_DIR:
        yield Path(NUMBA.CACHE_DIR)
        return
    yield _HERE / "__pycache__"
    with suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "sdp-slam"


def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            os.utime(folder)  # the folder that was used last is the last to go
    except OSError:
        return False
    return True


def _remove_old(base: Path) -> None:
    """Remove all but the folders that were used last; whatever is in the way of it stays."""
    with suppress(OSError):
        folders = sorted(base.glob(_PREFIX + "*"), key=lambda path: path.stat().st_mtime)
        for folder in folders[: -1 - KEPT]:
            shutil.rmtree(folder, ignore_errors=True)
