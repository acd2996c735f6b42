"""`slam demo --real`: the Killian Court, from the pose graph with scans that rtb-data ships."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from slam.evaluation.report.write import write_report
from slam.logs.errors import missing_extra
from slam.runs.config_file import load_config
from slam.runs.errors import RunError
from slam.runs.replay import replay
from slam.runs.run_directory import new_run
from slam.runs.thread_pool import thread_count
from slam.tools.imports import import_log

GRAPH = Path("data", "killian.g2o.zip")


def run_real_demo(out: Path, echo: Callable[[str], None]) -> None:
    """Make log, run and report of a real building in `out`; print what came of it.

    The scans lie about half a metre apart, so this shows matching, closing and the back end, not
    the choice of keyframes.  The graph's sequential edges, which drift by 18 m, are the odometry;
    its vertices, somebody else's solution, are what the report compares with, and no truth.

    Raises:
        RunError: rtb-data is not installed, or `out` exists already or cannot be made.
    """
    graph = shipped_graph()
    with new_run(out) as partial:
        log, run = partial / "killian.mcap", partial / "killian"
        imported = import_log(graph, log)
        echo(f"mapping {imported.scans} scans of the Killian Court; this takes a minute or two")
        summary = replay(log, run, load_config(None), threads=thread_count())
        reports = write_report([run], None, partial / "report.html")
    figures, loops = reports[0].figures, summary["loops"]
    Console(soft_wrap=True).print(
        f"{summary['keyframes']} keyframes, {loops['accepted']} loops, "
        f"{summary['distance_m']:.0f} m in {summary['timing']['wall_s']:.0f} s; "
        f"{figures['ate_rmse_m']:.2f} m rmse from the solution that came with the scans"
    )
    echo(f"map:    {out / 'killian' / 'map.png'}")
    Console(soft_wrap=True).print(f"report: {out / 'report.html'}")


def shipped_graph() -> Path:
    """The file in the installed rtb-data.

    Raises:
        RunError: it is not installed, or ships no such file.
    """
    found = importlib.util.find_spec("rtbdata")
    if found is None or found.origin is None:
        raise RunError(missing_extra("slam demo --real", "demo"))
    graph = Path(found.origin).parent / GRAPH
    if not graph.is_file():
        raise RunError(f"{graph}: this version of rtb-data has no such file; take another")
    return graph
