"""The commands that talk to a robot: `slam online` and `slam drivers probe`."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slam.cli.options import (
    LOCAL,
    PORT,
    AddressOption,
    FoxgloveOption,
    PortOption,
    TokenOption,
)
from slam.cli.output import LOSS, is_quiet

if TYPE_CHECKING:
    from slam.runs.status import Status

drivers_app = typer.Typer(help="Probe ports, or simulate devices.", no_args_is_help=True)
_QUIET_S = 5.0  # s between progress lines where stderr is no terminal


class _Expected(StrEnum):
    """What a probe asks for."""

    any = "any"
    laser = "laser"
    p3dx = "p3dx"


def online(
    config: Annotated[
        Path, typer.Option(help="robot.toml: ports, mount, settings.", readable=False)
    ],
    out: Annotated[Path, typer.Option(help="RUN directory to make.")],
    record_only: Annotated[bool, typer.Option(help="Record without mapping.")] = False,
    seconds: Annotated[
        float, typer.Option(min=0, help="Stop after this many seconds; 0: on Ctrl-C.")
    ] = 0.0,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Override a setting: section.key=value.")
    ] = None,
    view: Annotated[bool, typer.Option(help="Serve a page with the growing map.")] = True,
    view_address: AddressOption = LOCAL,
    view_port: PortOption = PORT,
    view_token: TokenOption = "",
    foxglove: FoxgloveOption = False,
) -> None:
    """Record and map on the robot until Ctrl-C. The motors are never commanded."""
    from slam.online.robot_config import load_robot
    from slam.online.run_online import run_online
    from slam.online.stop_request import StopRequest
    from slam.viewer.viewers import ViewOptions, watched

    settings = load_robot(config, set_ or [])
    progress = _Progress(sys.stderr.isatty())
    options = ViewOptions(view, view_address, view_port, view_token, foxglove)
    with StopRequest() as request, watched(options, _echo, needed=False) as viewers:
        timer = _Timer(seconds)
        summary = run_online(
            settings, out, record_only=record_only,
            stop=lambda: request() or timer.over(),
            on_status=progress, report=_echo, observer=viewers,
        )  # fmt: skip
    for cause, count in summary["lost"].items():
        _echo(f"  lost: {count} {cause}")
    typer.echo(f"{out}: {summary['scans']} scans, {summary.get('keyframes', 0)} keyframes")
    code = request.exit_code or (LOSS if summary["lost"] else 0)
    if code:
        raise typer.Exit(code)


@drivers_app.command()
def probe(
    ports: Annotated[
        list[str],
        typer.Argument(help="Serial devices, or tcp://host:port.", show_default=False),
    ],
    seconds: Annotated[float, typer.Option(min=0.2, help="How long to listen to each.")] = 1.5,
    expect: Annotated[
        _Expected, typer.Option(help="Ask for this device alone; any: for the laser first.")
    ] = _Expected.any,
) -> None:
    """Report what is connected to each port, and what to do if something is wrong."""
    from slam.drivers.probe import Kind
    from slam.drivers.probe import probe as ask

    kinds: dict[str, tuple[Kind, ...]] = {"laser": ("laser",), "p3dx": ("p3dx",)}

    reports = []
    for port in ports:
        _echo(f"{port}: asking ...")
        report = ask(port, seconds, kinds.get(expect, ("laser", "p3dx")))
        reports.append(report)
        typer.echo(f"{port}: {report.title}")
        for name, value in report.facts:
            typer.echo(f"  {name:<24} {value}")
        for advice in report.advice:
            typer.echo(f"  ! {advice}")
    if not all(report.sound for report in reports):
        raise typer.Exit(1)


@drivers_app.command()
def simulate(
    world: Annotated[str, typer.Option(help="Where the robot is.")] = "office",
    robot: Annotated[
        str, typer.Option(help="p3dx-sh, p3dx-sh-lms1xx, p3dx-sh-lms500 or p3dx.")
    ] = "p3dx-sh",
    laser: Annotated[
        str, typer.Option(help="utm-30lx, utm-30lx-ew, ust-10lx, ust-20lx or urg-04lx.")
    ] = "utm-30lx",
    baud: Annotated[int, typer.Option(help="Speed with which the robot starts.")] = 9600,
    robot_port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0: a pseudo-terminal.")
    ] = 0,
    laser_port: Annotated[
        int, typer.Option(min=0, max=65535, help="TCP port; 0: a pseudo-terminal.")
    ] = 0,
    drive: Annotated[
        bool,
        typer.Option(help="Drive by itself once both ports are read; else obey clients."),
    ] = False,
    folder: Annotated[
        Path | None, typer.Option(help="Folder for links to the pseudo-terminals.")
    ] = None,
) -> None:
    """Simulate a robot and a laser, for `slam online` or any other program, until Ctrl-C."""
    from slam.online.simulated_devices import SimulatedDevices
    from slam.online.stop_request import StopRequest

    devices = SimulatedDevices(
        world=world, robot=robot, laser=laser, baud=baud, robot_port=robot_port,
        laser_port=laser_port, drives=drive, folder=folder,
    )  # fmt: skip
    with StopRequest() as request:
        devices.serve(request, typer.echo)


class _Timer:
    """Runs from the first look at it, which is when the recording has begun."""

    def __init__(self, seconds: float) -> None:
        self._seconds, self._began = seconds, 0.0

    def over(self) -> bool:
        """Whether time is up; never without a limit."""
        self._began = self._began or time.monotonic()
        return self._seconds > 0 and time.monotonic() - self._began >= self._seconds


class _Progress:
    """News stay; the line of figures is rewritten on a terminal, elsewhere there is one more."""

    def __init__(self, terminal: bool) -> None:
        self._terminal, self._due_s = terminal, _QUIET_S

    def __call__(self, status: Status) -> None:
        erase = "\r\x1b[K" if self._terminal else ""
        for text in status.news:
            _echo(f"{erase}{text}")
        if self._terminal or status.seconds >= self._due_s:
            self._due_s = status.seconds + _QUIET_S
            line = status.line()
            if self._terminal and (status.alarm or status.warnings):
                line = typer.style(line, fg=typer.colors.RED)
            _echo(f"{erase}{line}", nl=not self._terminal)


def _echo(text: str, nl: bool = True) -> None:
    if is_quiet():
        return
    with suppress(OSError):  # the terminal was closed; the run is finished all the same
        typer.echo(text, err=True, nl=nl)
