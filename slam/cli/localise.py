"""`slam localise`: where the robot was in a finished map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from slam.cli.logs import LogArgument
from slam.cli.output import LOSS, echo, exit_on_loss


def localise(
    log: LogArgument,
    map_: Annotated[
        Path, typer.Option("--map", help="Finished RUN whose map it is; only read.", readable=False)
    ],
    out: Annotated[Path, typer.Option(help="RUN directory to make.")],
    start: Annotated[
        str,
        typer.Option(
            help="Where in that map the log starts, about: `end`, or x,y,yaw in m and rad; "
            "found by itself by default."
        ),
    ] = "",
    config: Annotated[
        Path | None, typer.Option(help="Configuration file (TOML).", readable=False)
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting: section.key=value.")
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Calibration of the robot, by `slam calibrate --out`.", readable=False),
    ] = None,
) -> None:
    """Find the robot in a finished map and track it there; the map stays as it is.

    Exit code 3 if the run ended lost, or data of the log was lost.
    """
    from slam.cli.progress import stage_progress
    from slam.online.robot_config import load_slam
    from slam.runs.localise import localise as run_localise

    settings = load_slam(config, set_ or [], calibration)
    with stage_progress(log) as progress:
        summary = run_localise(log, map_, out, settings, start, progress)
    _tell(out, summary)
    if summary["ended_lost"]:
        echo(f"  lost at the end: {_why(summary)}")
        raise typer.Exit(LOSS)
    exit_on_loss(summary["lost"], "lost")


def _tell(out: Path, summary: dict[str, Any]) -> None:
    after = summary["found_after_m"]
    found = "never found" if after is None else f"found after {after:.1f} m"
    timing = summary["timing"]
    typer.echo(
        f"{out}: {summary['localised_scans']} of {summary['scans']} scans localised, {found}, "
        f"lost {100 * summary['lost_share']:.1f} % of the time, {summary['distance_m']:.1f} m in "
        f"{timing['wall_s']:.1f} s ({timing['realtime_factor']:.0f}x real time)"
    )


def _why(summary: dict[str, Any]) -> str:
    if rivals := summary["rivals_at_end"]:
        return f"{rivals + 1} places look alike; drive on until they differ, or give --start"
    return (
        f"the pose is wrong with probability {summary['wrong_at_end']:.2f}; the robot may have "
        "left the map"
    )
