"""The commands that run many replays: `slam batch` and `slam tune`."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from slam.cli.output import LOSS, echo
from slam.logs.errors import missing_extra
from slam.runs.errors import RunError
from slam.runs.machine import usable_cores

_Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Worker processes on this machine; by default one per core."),
]
_Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler to use instead: tcp://host:8786.")
]
_Config = Annotated[Path | None, typer.Option(help="Configuration file (TOML).", readable=False)]
_Truth = Annotated[
    Path | None,
    typer.Option(help="Folder of truths: NAME.relations, .tum or .csv for NAME.mcap."),
]


def batch(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG...",
            help="Paths, patterns, or addresses that fsspec knows.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for table, report and results.")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="section.key=a,b,c; several give every combination."),
    ] = None,
    truth: _Truth = None,
    config: _Config = None,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
) -> None:
    """Replay and evaluate every log under every combination of settings.

    Run the same command again after an interruption: what is finished is not repeated. A log
    that fails becomes a row with its reason, and the exit code is 3. Needs the extra `batch`.
    """
    _need_the_extra()
    from slam.experiments.batch.batch import Batch, run_batch
    from slam.experiments.batch.engine import engine
    from slam.experiments.batch.grid import make_grid
    from slam.experiments.batch.report import lines

    grid = make_grid(config, set_ or [])
    with engine(_count(workers, scheduler), scheduler) as client:
        rows = run_batch(Batch(logs, grid, out, truth), client, echo)
    for line in lines(rows, grid):
        typer.echo(line)
    echo(f"report: {out / 'report.html'}, table: {out / 'table.parquet'}")
    _exit_on_loss(rows)


def tune(
    train: Annotated[list[str], typer.Option(help="A log, pattern or address to learn from.")],
    param: Annotated[
        list[str],
        typer.Option(help="Bounds: section.key=low:high[:log]; section.key.1 is in a list."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the study and the configuration.")],
    score: Annotated[
        list[str] | None, typer.Option(help="A log for evaluation, which the search never sees.")
    ] = None,
    objective: Annotated[
        str, typer.Option(help="relations, ate, or matches (at no more error than --against).")
    ] = "ate",
    trials: Annotated[int, typer.Option(min=1, help="In total, with those of earlier runs.")] = 50,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    together: Annotated[
        int, typer.Option(min=1, help="Trials chosen at once; keeps more workers busy.")
    ] = 4,
    against: Annotated[
        list[str] | None,
        typer.Option(help="section.key=value of the reference; by default that of the start."),
    ] = None,
    truth: _Truth = None,
    config: _Config = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Where to start: section.key=value.")
    ] = None,
    storage: Annotated[
        str | None, typer.Option(help="Database of the study; by default OUT/study.db.")
    ] = None,
    workers: _Workers = None,
    scheduler: _Scheduler = None,
) -> None:
    """Find the settings that do best on some logs, and evaluate them on others.

    Continues where it was interrupted. Needs the extra `batch`.
    """
    _need_the_extra()
    from slam.experiments.batch.engine import engine
    from slam.experiments.tune.objective import parse_objective
    from slam.experiments.tune.report import summary_lines, write_tuned
    from slam.experiments.tune.space import parse_parameters
    from slam.experiments.tune.study import Search
    from slam.experiments.tune.tune import Tuning
    from slam.experiments.tune.tune import tune as run_tune
    from slam.runs.config_file import load_config

    start = load_config(config, set_ or [])
    plan = Search(parse_parameters(param, start), trials, together, seed)
    tuning = Tuning(
        train, score or [], parse_objective(objective), start,
        load_config(config, [*(set_ or []), *(against or [])]), plan, out, truth, storage,
    )  # fmt: skip
    with engine(_count(workers, scheduler), scheduler) as client:
        tuned = run_tune(tuning, client, echo)
    write_tuned(tuned)
    for line in summary_lines(tuned):
        typer.echo(line)
    echo(f"configuration: {out / 'config.toml'}")
    unjudged = [entry.log for entry in tuned.scoring if not math.isfinite(entry.found.error_m)]
    for log in unjudged:
        echo(f"  failed: {log}, or it has no truth for the objective")
    if unjudged:
        raise typer.Exit(LOSS)


def _exit_on_loss(rows: list[dict[str, Any]]) -> None:
    """Say each reason once, with the number of its rows."""
    failed = Counter(row["reason"] for row in rows if row["status"] != "ok")
    for reason, count in failed.items():
        echo(f"  failed: {count} x {reason}")
    lost = Counter(f"{row['log']}: {row['losses']}" for row in rows if row["lost"])
    for losses, count in lost.items():
        echo(f"  lost: {count} x {losses}")
    if failed or lost:
        raise typer.Exit(LOSS)


def _count(workers: int | None, scheduler: str | None) -> int:
    """How many workers to start here.

    Raises:
        BadParameter: both a number and a scheduler were given.
    """
    if workers and scheduler:
        raise typer.BadParameter("--workers is for this machine, --scheduler for others: say one")
    return workers or usable_cores()


def _need_the_extra() -> None:
    try:
        import distributed  # noqa: F401
        import optuna  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise RunError(missing_extra("this command", "batch")) from error
