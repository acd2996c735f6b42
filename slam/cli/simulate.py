"""`slam simulate`: a simulated drive as a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.output import echo


def simulate(
    world: Annotated[str, typer.Argument(help="Name of a world; `list` names them all.")],
    out: Annotated[Path | None, typer.Option(help="Log to write (.mcap).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Decides geometry, noise and odometry.")] = 0,
    laser: Annotated[
        str,
        typer.Option(
            help="Preset of the range finder: hokuyo-181, utm-30lx, urg-04lx, sick-361, lds-01, "
            "rplidar-a1 or ld06."
        ),
    ] = "hokuyo-181",
    noise: Annotated[str, typer.Option(help="Preset of the odometry's noise.")] = "typical",
    passes: Annotated[
        int, typer.Option(min=1, help="Passes through the world; every second one in reverse.")
    ] = 1,
    laser_pose: Annotated[
        str, typer.Option(help="Where the laser sits: x,y,theta in m and rad, or `0.1,0,90deg`.")
    ] = "0.16,0,0",
    stated_pose: Annotated[
        str, typer.Option(help="Where the log says that it sits.", show_default="where it does")
    ] = "",
    wheel_scales: Annotated[
        str, typer.Option(help="True size of left and right wheel over the size taken: 1.03,1.03.")
    ] = "1,1",
    track_scale: Annotated[
        float, typer.Option(help="True track width over that taken, 0.357 m.")
    ] = 1.0,
    odometry_delay: Annotated[
        float, typer.Option(help="s by which the odometry's stamps are late.")
    ] = 0.0,
) -> None:
    """Drive a simulated robot through a world and log what it senses, with the truth."""
    from slam.tools.simulate import Robot, simulate_log, world_names

    if world == "list":
        typer.echo("\n".join(world_names()))
        return
    if out is None:
        raise typer.BadParameter("say where to write the log: --out FILE.mcap")
    try:
        robot = Robot.of(laser_pose, stated_pose, wheel_scales, track_scale, odometry_delay)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    count = simulate_log(world, out, seed, laser, noise, passes, robot)
    echo(f"{out}: {count} messages")
