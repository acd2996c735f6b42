"""The commands that make logs, look into them, and turn them into others."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam.cli.output import LOSS, exit_on_loss, say

# `readable=False`: whoever opens a file says in one line why it cannot be read.
LogArgument = Annotated[
    Path, typer.Argument(help="An MCAP log.", show_default=False, readable=False)
]


def simulate(
    world: Annotated[str, typer.Argument(help="Name of a world; `list` names them all.")],
    out: Annotated[Path | None, typer.Option(help="Log to write (.mcap).")] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Geometry, noise and odometry follow from it.")
    ] = 0,
    laser: Annotated[str, typer.Option(help="Preset of the range finder.")] = "hokuyo-181",
    noise: Annotated[str, typer.Option(help="Preset of the odometry's noise.")] = "typical",
    passes: Annotated[
        int, typer.Option(min=1, help="Ways through the world, every other one back in reverse.")
    ] = 1,
) -> None:
    """Drive a simulated robot through a world and log what it senses, with the truth."""
    from slam.tools.simulate import simulate_log, world_names

    if world == "list":
        typer.echo("\n".join(world_names()))
        return
    if out is None:
        raise typer.BadParameter("say where to write the log: --out FILE.mcap")
    count = simulate_log(world, out, seed, laser, noise, passes)
    say(f"{out}: {count} messages")


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="CARMEN (.clf, .log) or BreezySLAM (.dat) log, ROS 1 bag, ROS 2 bag (folder, "
            ".mcap, .db3), or g2o graph with ROBOTLASER1 lines; texts may be gzipped.",
            readable=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Log to write (.mcap).")],
) -> None:
    """Turn a foreign log into an MCAP log; what is repaired or skipped is counted.

    ROS bags need the extra `ros`; their times of receipt are kept.
    """
    from slam.tools.imports import import_log

    report = import_log(file, out)
    say(f"{out}: {report.scans} scans, {report.messages} messages from {report.kind}")
    for cause, count in report.changed.items():
        say(f"  repaired: {count} {cause}")
    for cause, count in report.ignored.items():
        say(f"  left out: {count} {cause}")
    exit_on_loss(report.skipped, "skipped")


def info(log: LogArgument) -> None:
    """Say what a log holds: channels, rates, gaps, losses, identity."""
    from slam.tools.inspect import describe_log

    typer.echo(describe_log(log))


def doctor(
    log: LogArgument,
    json_: Annotated[
        Path | None, typer.Option("--json", help="File for the findings, for programs.")
    ] = None,
) -> None:
    """Say what is odd about a log; exit code 3 on warnings, 1 on errors."""
    from slam.cli.progress import count_progress
    from slam.tools.inspect import examine_log

    with count_progress(log, "examining") as progress:
        text, code = examine_log(log, json_, progress)
    typer.echo(text)
    if code:
        raise typer.Exit(code)


def recover(
    file: Annotated[
        Path, typer.Argument(help="A log that was not closed, or is damaged.", readable=False)
    ],
    out: Annotated[Path, typer.Option(help="Sound log to write (.mcap).")],
) -> None:
    """Save what is intact of a damaged log; exit code 3 if anything was lost."""
    from slam.logs.recover import recover as recover_log

    found = recover_log(file, out)
    say(f"{out}: {sum(found.messages.values())} messages saved")
    for problem in found.problems:
        say(f"  {problem}")
    if found.lost:
        raise typer.Exit(LOSS)


def export(
    source: Annotated[Path, typer.Argument(help="An MCAP log, or a RUN.", readable=False)],
    ros2: Annotated[Path | None, typer.Option(help="ROS 2 bag (folder) to make.")] = None,
    carmen: Annotated[Path | None, typer.Option(help="CARMEN log to write.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Folder of tables to make.")] = None,
    tum: Annotated[Path | None, typer.Option(help="TUM trajectory to write.")] = None,
    g2o: Annotated[Path | None, typer.Option(help="Graph to write, of a RUN.")] = None,
    poses: Annotated[
        str,
        typer.Option(
            help="What --tum writes: odometry or truth of a log, trajectory, keyframes or "
            "odometry of a RUN; the first of these if not said."
        ),
    ] = "",
) -> None:
    """Write a log or a RUN in foreign formats, one or several at once."""
    from slam.tools.exports import Targets
    from slam.tools.exports import export as run_export

    targets = Targets(ros2=ros2, carmen=carmen, csv=csv, tum=tum, g2o=g2o, poses=poses)
    if not targets.paths():
        raise typer.BadParameter("say what to write: --ros2, --carmen, --csv, --tum or --g2o")
    done = run_export(source, targets)
    for line in done.written:
        say(line)
    exit_on_loss(done.lost, "lost")
