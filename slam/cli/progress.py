"""Progress bars on the terminal for anything that takes more than a moment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from slam.cli.output import echo
from slam.logs.errors import LogError
from slam.logs.parts import Recording
from slam.runs.offline import Progress as Tell

EVERY = 200  # messages between two updates: drawing must not cost time


@contextmanager
def stage_progress(log: Path) -> Iterator[Tell]:
    """A bar per stage of a run over `log`, on stderr.

    Where that is no terminal it is silent, but for a line if kernels have to be compiled first.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _tell_compiling
        return
    try:
        counts = Recording(log).counts()
    except LogError:  # the run itself will say it better
        counts = {}
    totals = {"tracking": sum(counts.values()), "localising": counts.get("/scan", 0)}
    columns = TextColumn("{task.description:<12}"), BarColumn(), TimeRemainingColumn()
    # No thread that draws by itself: a run may go on in copies of this process.
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(stage: str, done: float) -> None:
            if done % EVERY:
                return
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=totals.get(stage))
            bars.update(tasks[stage], completed=done, refresh=True)

        yield tell


def _tell_compiling(stage: str, done: float) -> None:
    if stage == "compiling":
        echo("compiling kernels: once after an installation, it takes a moment")


@contextmanager
def count_progress(log: Path, what: str) -> Iterator[Callable[[int], None]]:
    """A bar over the messages of a log, on stderr; one line before it begins where there is none.

    At the end of the bar the work need not be done.
    """
    console = Console(stderr=True)
    try:
        total = sum(Recording(log).counts().values())
    except LogError:  # who reads it says it better
        total = 0
    if not console.is_terminal:
        if total:
            echo(f"{what} {total} messages")
        yield lambda messages: None
        return
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task(what, total=total or None)
        yield lambda messages: bars.update(task, completed=messages)
