"""`slam demo`: the paper's test bed, driven on simulated devices, mapped and compared in one go."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

from slam.drivers.simulators.drive import paper_drive
from slam.evaluation.report.write import write_report
from slam.logs.mcap_log import LogWriter
from slam.runs.config_file import load_config
from slam.runs.errors import RunError
from slam.runs.replay import replay
from slam.runs.run_directory import new_run

READING: Literal["878cm"] = "878cm"  # 462 scans, 1.9 cm apart; not the 180 cm also stated
CONSTANT = (1, 5, 10, 15, 20)  # scans, Section V

# Intervals count scans here, as in the paper, and the corridor has no loop to close.
PAPER = ("keyframes.unit=scans", "keyframes.max_turn=3.2", "loops.enabled=false")
SDP_PE = ("keyframes.method=sdp-pe", "keyframes.min_interval=15", "keyframes.max_interval=30")


def run_demo(out: Path, echo: Callable[[str], None], direct: bool = False) -> None:
    """Make the log, a run per method and the report in `out`; print the comparison.

    With `direct`, the log comes from the simulator itself, without devices and their wires.

    Raises:
        RunError: `out` exists already or cannot be made, or the online command failed.
    """
    with new_run(out) as partial:
        table = _compare(partial, echo, direct)
    Console().print(table)
    echo(
        "one drive proves nothing: which choice ends nearer changes from drive to drive; "
        "docs/results.md has the means of many"
    )
    echo(f"map:    {out / 'sdp-pe' / 'map.png'}")
    Console(soft_wrap=True).print(f"report: {out / 'report.html'}")


def _compare(out: Path, echo: Callable[[str], None], direct: bool) -> Table:
    """Fill the folder with the log, a run per method and their report."""
    truth = None if direct else out / "truth.tum"
    log = _simulated(out, echo) if direct else _recorded(out, echo)
    echo("replaying the log with SDP-PE and with constant intervals")
    summaries = {"SDP-PE": replay(log, out / "sdp-pe", load_config(None, [*PAPER, *SDP_PE]))}
    for interval in CONSTANT:
        sets = [*PAPER, "keyframes.method=constant", f"keyframes.interval={interval}"]
        name = f"constant {interval}"
        summaries[name] = replay(log, out / f"constant-{interval}", load_config(None, sets))
    if not direct:
        _require_same(out / "online", out / "sdp-pe")
        echo("the graph of the online run and that of its replay are the same, bit for bit")
    runs = [out / name.lower().replace(" ", "-") for name in summaries]
    reports = write_report(runs, truth, out / "report.html")
    return comparison(summaries, [report.figures for report in reports])


def _recorded(out: Path, echo: Callable[[str], None]) -> Path:
    """Drive on simulated devices, watched by the online command; returns its log."""
    from slam.tools.demo.drive import drive_online  # needs pseudo-terminals

    echo("a simulated P3-DX and a simulated UTM-30LX wait on pseudo-terminals for `slam online`")
    drive_online(out, load_config(None, [*PAPER, *SDP_PE]), echo)
    return out / "online" / "run.mcap"


def _simulated(out: Path, echo: Callable[[str], None]) -> Path:
    """Write the simulator's messages straight into a log."""
    log = out / "testbed.mcap"
    echo("driving 462 scans through the simulated test bed")
    with LogWriter(log, {"world": "testbed", "reading": READING}, keep_partial=False) as writer:
        for message in paper_drive(READING):
            writer.write(message)
    return log


def _require_same(online: Path, replayed: Path) -> None:
    for name in ("graph.g2o", "trajectory.tum"):
        if (online / name).read_bytes() != (replayed / name).read_bytes():
            raise RunError(f"{name} of the online run and of its replay differ: a defect of ours")


def comparison(summaries: dict[str, dict[str, Any]], figures: list[dict[str, Any]]) -> Table:
    """The paper's Figure 7 as a table of this run."""
    table = Table(title="one drive through the test bed: what each choice of scans costs and gives")
    table.add_column("keyframes")
    for heading in ("scans used", "matches", "matching ms", "final error cm"):
        table.add_column(heading, justify="right")
    for (name, summary), found in zip(summaries.items(), figures, strict=True):
        table.add_row(
            name, str(summary["keyframes"]), str(summary["matches"]),
            f"{1e3 * summary['timing']['stages_s']['matching']:.1f}",
            f"{100 * found['final_pose_error_m']:.2f}",
        )  # fmt: skip
    return table
