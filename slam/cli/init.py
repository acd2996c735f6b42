"""`slam init`: find the devices and write the files that a robot's computer needs."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path
from typing import Annotated

import typer

from slam.cli.output import echo
from slam.runs.errors import RunError


def init(
    ports: Annotated[
        list[str] | None,
        typer.Argument(
            help="Serial devices, or tcp://host:port; all serial ports there are if none is named.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="File to write.")] = Path("robot.toml"),
    mount_x: Annotated[
        float | None, typer.Option(help="m, of the laser ahead of the wheel axis.")
    ] = None,
    mount_y: Annotated[float, typer.Option(help="m, to the left of it.")] = 0.0,
    mount_theta_deg: Annotated[float, typer.Option(help="deg, anticlockwise.")] = 0.0,
    udev: Annotated[
        Path | None, typer.Option(help="Also write udev rules: lasting names for the ports.")
    ] = None,
    systemd: Annotated[
        Path | None, typer.Option(help="Also write a systemd unit that maps from boot on.")
    ] = None,
) -> None:
    """Ask the ports which device they have, and write robot.toml. The motors are never touched.

    Nothing is installed, and no file is replaced.
    """
    from serial.tools import list_ports

    from slam.drivers.probe import probe
    from slam.online.setup_files import (
        Mount,
        lasting_name,
        robot_toml,
        systemd_unit,
        udev_rules,
    )

    for path in (out, udev, systemd):
        if path is not None and path.exists():
            raise RunError(f"{path}: exists already: choose another name, or remove it first")
    usb = list(list_ports.comports())
    reports = []
    for port in ports or [info.device for info in usb]:
        echo(f"{port}: asking ...")
        report = probe(port)
        echo(f"{port}: {report.title}")
        for advice in report.advice:
            echo(f"  ! {advice}")
        reports.append(report)
    found = {report.kind: lasting_name(report.port) for report in reports if report.kind}
    mount = Mount(mount_x, mount_y, mount_theta_deg)
    texts = {out: robot_toml({str(kind): port for kind, port in found.items()}, mount)}
    if udev is not None:
        texts[udev] = udev_rules(reports, usb)
    if systemd is not None:
        program = Path(sys.argv[0])
        texts[systemd] = systemd_unit(program, out, out.absolute().parent, getpass.getuser())
    for path, text in texts.items():
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
        echo(f"{path}: written")
    missing = [device for device in ("p3dx", "laser") if device not in found]
    if missing or mount_x is None:
        what = [*(f"the port of the {device}" for device in missing)]
        what += ["mount.x"] if mount_x is None else []
        echo(f"{out}: still lacks {', '.join(what)}")
        raise typer.Exit(1 if missing else 0)
