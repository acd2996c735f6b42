"""Compiled kernels must be those of the source under test; CI draws the same examples each time."""

import os
from pathlib import Path

from hypothesis import settings

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

FRONTEND = Path(__file__).parents[1] / "frontend"
ALTERNATIVES = ("point_to_point.py", "ndt.py", "psm.py")


def stale(cache: Path, sources: list[Path]) -> list[Path]:
    """Compiled kernels in `cache` that are older than any of the sources.

    Numba looks at a kernel's own file only: a change in another module that the kernel calls
    would go unnoticed.
    """
    newest = max(source.stat().st_mtime for source in sources)
    compiled = [*cache.glob("*.nbi"), *cache.glob("*.nbc")]
    return [path for path in compiled if path.stat().st_mtime < newest]


def pytest_configure(config):
    sources = [*FRONTEND.glob("*_kernels.py"), *(FRONTEND / name for name in ALTERNATIVES)]
    for path in stale(FRONTEND / "__pycache__", sources):
        path.unlink(missing_ok=True)
