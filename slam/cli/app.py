"""The `slam` command: each subcommand only wires parts that live elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from slam.cli.batch import batch, tune
from slam.cli.calibrate import calibrate
from slam.cli.checkout import load_benchmarks
from slam.cli.init import init
from slam.cli.localise import localise
from slam.cli.logs import LogArgument, doctor, export, import_, info, recover
from slam.cli.online import drivers_app, online
from slam.cli.options import (
    LOCAL,
    PORT,
    AddressOption,
    FoxgloveOption,
    PortOption,
    TokenOption,
)
from slam.cli.output import echo, exit_on_loss, print_version, set_talk
from slam.cli.simulate import simulate

app = typer.Typer(
    name="slam",
    help="2D laser SLAM for a Pioneer P3-DX and a Hokuyo: SDP-PE keyframes, ICP factors, GTSAM.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ConfigOption = Annotated[
    Path | None, typer.Option(help="Configuration file (TOML).", readable=False)
]
SetOption = Annotated[
    list[str] | None, typer.Option("--set", help="Override a setting: section.key=value.")
]
TruthOption = Annotated[
    Path | None,
    typer.Option(help="Truth: relations, TUM trajectory, or surveyed poses (CSV).", readable=False),
]


class _From(StrEnum):
    """What a replay takes its messages from."""

    decoded = "decoded"
    raw = "raw"


class _Frame(StrEnum):
    """Whose poses a report compares with the truth."""

    base = "base"
    laser = "laser"


def replay(
    log: LogArgument,
    out: Annotated[Path, typer.Option(help="RUN directory to make.")],
    config: ConfigOption = None,
    set_: SetOption = None,
    from_: Annotated[
        _From,
        typer.Option("--from", help="Logged messages, or raw bytes decoded again."),
    ] = _From.decoded,
    rate: Annotated[
        float, typer.Option(min=0, help="1: at the pace of the drive; 0: as fast as possible.")
    ] = 0.0,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Calibration of the robot, by `slam calibrate --out`.", readable=False),
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(help="RUN whose map to continue.", readable=False)
    ] = None,
    start: Annotated[
        str,
        typer.Option(
            help="With --resume, where in that map the log starts: `end`, or x,y,theta in m and "
            "rad; searched for by default."
        ),
    ] = "",
    view: Annotated[
        bool, typer.Option("--view", help="Serve a page with the growing map.")
    ] = False,
    view_address: AddressOption = LOCAL,
    view_port: PortOption = PORT,
    view_token: TokenOption = "",
    foxglove: FoxgloveOption = False,
    threads: Annotated[
        int,
        typer.Option(
            "--threads",
            "--processes",  # what they were before
            min=0,
            help="Threads that place the scans at the end; 0: one per core, at most 4. The result "
            "is the same.",
        ),
    ] = 0,
) -> None:
    """Run SLAM over a log, as fast as possible or at its own pace; the result is the same."""
    from slam.cli.progress import stage_progress
    from slam.online.robot_config import load_slam
    from slam.runs.replay import replay as run_replay
    from slam.runs.resume import read_prior_map
    from slam.runs.thread_pool import thread_count
    from slam.viewer.viewers import ViewOptions, watched

    if start and resume is None:
        raise typer.BadParameter("--start says where in the map of --resume RUN the log starts")
    settings = load_slam(config, set_ or [], calibration)
    prior_map = read_prior_map(resume, settings, start) if resume else None
    options = ViewOptions(view, view_address, view_port, view_token, foxglove)
    with watched(options, echo) as viewers, stage_progress(log) as progress:
        raw = from_ is _From.raw
        summary = run_replay(
            log, out, settings, progress, raw, rate, viewers, prior_map, threads or thread_count()
        )
    _tell_summary(out, summary)
    exit_on_loss(summary["lost"], "lost")


def report(
    runs: Annotated[list[Path], typer.Argument(help="RUN directories.", show_default=False)],
    truth: TruthOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Page to write, its figures beside it as .json; needed for several runs.",
            show_default="report.html in RUN",
        ),
    ] = None,
    frame: Annotated[
        _Frame,
        typer.Option(help="What the truth speaks of: relations by scan matching of the laser."),
    ] = _Frame.base,
) -> None:
    """Evaluate runs against their truth; write report.html and report.json."""
    from slam.evaluation.report.write import write_report

    if out is None and len(runs) > 1:
        raise typer.BadParameter("several runs need --out PAGE, such as --out compared.html")
    page = out or runs[0] / "report.html"
    reports = write_report(runs, truth, page, frame.value)
    for found in reports:
        _tell_figures(found.figures)
        for warning in found.warnings:
            echo(f"  note: {warning}")
    echo(f"report: {page}")


def reoptimise(
    source: Annotated[Path, typer.Argument(help="RUN directory, or a g2o file.")],
    out: Annotated[Path, typer.Option(help="RUN directory to make.")],
    config: ConfigOption = None,
    set_: SetOption = None,
) -> None:
    """Optimise a finished graph again, with other noise, robust losses or closures."""
    from slam.runs.reoptimise import reoptimise as run_reoptimise

    summary = run_reoptimise(source, out, config, set_ or [])
    loops = summary["loops"]
    echo(
        f"{out}: {summary['keyframes']} poses, {summary['edges']} edges, "
        f"error {summary['error_before']:.4g} -> {summary['error_after']:.4g}, "
        f"{loops['rejected']} of {loops['candidates']} loops refused"
    )
    exit_on_loss(summary.get("lost", {}), "left out")


def demo(
    out: Annotated[Path, typer.Option(help="Folder to make.")] = Path("demo-out"),
    direct: Annotated[
        bool,
        typer.Option("--direct", help="No simulated devices, where ptys are missing."),
    ] = False,
    real: Annotated[
        bool, typer.Option("--real", help="Map a real building instead; needs the extra `demo`.")
    ] = False,
) -> None:
    """Drive the paper's test bed on simulated devices; compare SDP-PE with constant intervals."""
    if real:
        from slam.tools.demo.real import run_real_demo

        if direct:
            raise typer.BadParameter("--real has no devices: leave --direct out")
        run_real_demo(out, echo)
        return
    from slam.tools.demo.demo import run_demo

    run_demo(out, echo, direct)


def bench(
    name: Annotated[
        str,
        typer.Argument(help="Name of a benchmark; `list` names them all."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the JSON file.")] = Path("bench-out"),
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of recorded logs and graphs, for benchmarks that need them."),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Fewer samples, for a first look.")] = False,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes to spread it over, where it can be; 0: none.")
    ] = 0,
) -> None:
    """Measure, print a table and write NAME.json."""
    benchmarks = load_benchmarks()
    if name == "list":
        typer.echo("\n".join(benchmarks.described()))
        return
    benchmarks.run_bench(name, out, data, quick, echo, workers)


def _tell_summary(out: Path, summary: dict[str, Any]) -> None:
    timing, loops = summary["timing"], summary["loops"]
    typer.echo(
        f"{out}: {summary['scans']} scans, {summary['keyframes']} keyframes, "
        f"{summary['matches']} matches, {loops['accepted']} loops of {loops['candidates']} tried, "
        f"{summary['distance_m']:.1f} m in {timing['wall_s']:.1f} s "
        f"({timing['realtime_factor']:.0f}x real time)"
        + (", by the laser alone" if summary["laser_only"] else "")
    )


def _tell_figures(figures: dict[str, Any]) -> None:
    relations = figures.get("relations")
    if relations and relations["n"]:
        typer.echo(
            f"{figures['name']}: relations {relations['trans_mean_m']:.4f} +- "
            f"{relations['trans_std_m']:.4f} m, {relations['rot_mean_deg']:.3f} +- "
            f"{relations['rot_std_deg']:.3f} deg (n = {relations['n']}, "
            f"{relations['missing']} missing)"
        )
    if figures.get("ate_rmse_m") is not None:
        typer.echo(
            f"{figures['name']}: ATE {figures['ate_rmse_m']:.4f} m rmse, final pose error "
            f"{figures['final_pose_error_m']:.4f} m"
        )


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version and end.", is_eager=True, callback=print_version
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Results and errors alone: no other talk.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="With an error, also where it came from.")
    ] = False,
) -> None:
    """2D laser SLAM for a Pioneer P3-DX and a Hokuyo."""
    set_talk(quiet=quiet, verbose=verbose)


GROUPS: dict[str, dict[str, Callable[..., None]]] = {
    "Map": {
        "replay": replay, "localise": localise, "report": report, "reoptimise": reoptimise,
        "demo": demo,
    },
    "Robot": {"init": init, "calibrate": calibrate, "online": online},
    "Logs": {
        "simulate": simulate, "import": import_, "info": info, "doctor": doctor,
        "recover": recover, "export": export,
    },
    "Experiments": {"batch": batch, "tune": tune, "bench": bench},
}  # fmt: skip
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
for panel, commands in GROUPS.items():
    for name, command in commands.items():
        app.command(name, rich_help_panel=panel)(command)
app.add_typer(drivers_app, name="drivers", rich_help_panel="Robot")
