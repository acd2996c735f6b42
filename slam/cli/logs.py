"""The commands that make, examine and convert logs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from slam.cli.output import LOSS, echo, exit_on_loss

# `readable=False`: whoever opens a file says in one line why it cannot be read.
LogArgument = Annotated[
    Path, typer.Argument(help="An MCAP log.", show_default=False, readable=False)
]


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            help="ROS 1 bag, ROS 2 bag (folder, .mcap, .db3), log of CARMEN (.clf, .log), "
            "BreezySLAM (.dat), ARIA (.2d) or MRPT (.rawlog), YDLidar text, or g2o graph with "
            "ROBOTLASER1 lines; "
            "texts may be gzipped.",
            readable=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Log to write (.mcap).")],
    scan: Annotated[str, typer.Option(help="Topic of the scans, in a ROS recording.")] = "",
    odom: Annotated[
        str,
        typer.Option(
            help="Topic of the odometry, a link of /tf as `odom>base_link`, or `none`.",
        ),
    ] = "",
    base: Annotated[str, typer.Option(help="Frame of the robot's base.")] = "",
    mount: Annotated[
        str,
        typer.Option(
            help="Where the laser sits on the base: x,y,theta in m, m and rad, or with a unit: "
            "`0.2,0,90deg`.",
        ),
    ] = "",
    use_receipt_time: Annotated[
        bool,
        typer.Option(
            "--use-receipt-time", help="Go by the times of receipt where stamps are wrong."
        ),
    ] = False,
    from_: Annotated[
        float, typer.Option("--from", min=0, help="Leave out what is earlier (s from the start).")
    ] = 0.0,
    to: Annotated[
        float, typer.Option(min=0, help="Leave out what is later (s from the start); 0: nothing.")
    ] = 0.0,
    drive: Annotated[
        int, typer.Option(min=0, help="Which drive, from 1, where the recording holds several.")
    ] = 0,
    fov: Annotated[
        float,
        typer.Option(
            min=0,
            max=360,
            help="Field of view of the laser in degrees, where the format does not state it.",
        ),
    ] = 0.0,
) -> None:
    """Turn a foreign log into an MCAP log; what is repaired or skipped is counted.

    ROS bags need the extra `ros`; their times of receipt are kept.  `slam info` shows the
    topics and frames of a recording.  A choice that had to be guessed ends with exit code 3.
    """
    from slam.logs.importers.wishes import Wishes, parse_mount
    from slam.tools.imports import import_log

    try:
        place = parse_mount(mount) if mount else None
    except ValueError as error:
        raise typer.BadParameter(f"--mount {error}") from error
    wishes = Wishes(
        scan=scan, odometry=odom, base=base, mount=place, receipt_time=use_receipt_time,
        start_s=from_, end_s=to or math.inf, drive=drive, view_deg=fov,
    )  # fmt: skip
    report = import_log(file, out, wishes)
    echo(f"{out}: {report.scans} scans, {report.messages} messages from {report.kind}")
    if report.notes:
        echo(f"  {', '.join(report.notes)}")
    for cause, count in report.changed.items():
        echo(f"  repaired: {count} {cause}")
    for cause, count in report.ignored.items():
        echo(f"  left out: {count} {cause}")
    for warning in report.warnings:
        echo(f"  warning: {warning}")
    exit_on_loss(report.skipped, "skipped")
    if report.warnings:
        raise typer.Exit(LOSS)


def info(log: LogArgument) -> None:
    """Describe a log: channels, rates, gaps, losses, identity.

    Of a recording of other programs: topics, types, rates and frames, and what an import of it
    would choose.
    """
    from slam.tools.inspect import describe_log

    typer.echo(describe_log(log))


def doctor(
    log: LogArgument,
    json_: Annotated[
        Path | None, typer.Option("--json", help="File for the findings as JSON.")
    ] = None,
) -> None:
    """Check a log and list what is odd; exit code 3 on warnings, 1 on errors."""
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
    out: Annotated[Path, typer.Option(help="Intact log to write (.mcap).")],
) -> None:
    """Save what is intact of a damaged log; exit code 3 if anything was lost."""
    from slam.logs.recover import recover as recover_log

    found = recover_log(file, out)
    echo(f"{out}: {sum(found.messages.values())} messages saved")
    for problem in found.problems:
        echo(f"  {problem}")
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
            "odometry of a RUN; by default the first of these."
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
        echo(line)
    exit_on_loss(done.lost, "lost")
