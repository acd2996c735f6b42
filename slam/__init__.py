"""2D laser pose-graph SLAM from Python.

    import slam

    run = slam.replay("drive.mcap")
    print(slam.evaluate(run, truth="drive.relations"))

Everything here is loaded at its first use, so that `import slam` is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from slam.evaluation.interface import Evaluation, evaluate
    from slam.runs.mapper import Mapper
    from slam.runs.run import Run, replay
    from slam.runs.scan_match import Match, Scan, match

__all__ = ["Evaluation", "Mapper", "Match", "Run", "Scan", "evaluate", "match", "replay"]

_HOMES = {
    "Evaluation": "slam.evaluation.interface",
    "evaluate": "slam.evaluation.interface",
    "Mapper": "slam.runs.mapper",
    "Match": "slam.runs.scan_match",
    "Run": "slam.runs.run",
    "Scan": "slam.runs.scan_match",
    "match": "slam.runs.scan_match",
    "replay": "slam.runs.run",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'slam' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
