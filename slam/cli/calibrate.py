"""`slam calibrate`: where the laser sits and what the odometry is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.output import LOSS, echo


def calibrate(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="MCAP logs of one robot, its laser at one place.", show_default=False,
            readable=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="File to write, for `slam replay --calibration` or robot.toml."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Configuration file (TOML).", readable=False)
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting: section.key=value.")
    ] = None,
    track: Annotated[
        float,
        typer.Option(
            min=0, help="m, track width that the odometry was computed with: then each wheel and "
            "the track are told apart. 0: as the logs say.",
        ),
    ] = 0.0,
) -> None:  # fmt: skip
    """Find where the laser sits, the scales of the wheels and the odometry's delay, with sigmas.

    What the drive does not show is refused, with the reason and how to drive to see it; exit
    code 3 then.
    """
    from slam.cli.progress import count_progress
    from slam.online.robot_config import load_slam
    from slam.tools.calibrate import calibrate_logs, described, write_calibration

    settings = load_slam(config, set_ or [])
    with count_progress(logs[0], "comparing") as progress:
        found = calibrate_logs(logs, settings, track, progress)
    typer.echo("\n".join(described(found)))
    if out is not None:
        write_calibration(found, logs, out)
        echo(f"calibration: {out}")
    if any(one.refused for one in found.found):
        raise typer.Exit(LOSS)
