"""Files that a robot's computer needs: robot.toml, udev rules, a systemd unit."""

from __future__ import annotations

import glob
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from slam.drivers.probe import ProbeReport
from slam.runs.errors import RunError

_BY_ID = "/dev/serial/by-id/*"
_NAMES = {"laser": "hokuyo", "p3dx": "p3dx"}  # of the links that the udev rules make
_STOP_S = 600  # s that the unit gives a run to finish its map


@dataclass(frozen=True, slots=True)
class Mount:
    """Where the laser sits: `base_T_laser`, m and deg; None if it has not been measured."""

    x: float | None = None
    y: float = 0.0
    theta_deg: float = 0.0


class UsbPort(Protocol):
    """What pyserial knows of a port."""

    device: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    location: str | None


def lasting_name(port: str, pattern: str = _BY_ID) -> str:
    """Return a name of the port that stays when plugs are pulled, the port itself if none."""
    if "://" in port:
        return port
    itself = os.path.realpath(port)
    return next((link for link in sorted(glob.glob(pattern)) if os.path.realpath(link) == itself),
                port)  # fmt: skip


def robot_toml(ports: Mapping[str, str], mount: Mount) -> str:
    """Return the text of a robot.toml for the ports of `p3dx` and `laser`.

    What is not known is left out, with a line that says so: `slam online` asks for it.
    """
    lines = ["# All settings: docs/online.md. The motors are never switched on from here."]
    for section, device in (("robot", "p3dx"), ("laser", "laser")):
        lines += ["", f"[{section}]"]
        port = ports.get(device)
        lines.append(
            f'port = "{_plain(port)}"' if port else f"# port = ...  # no {device} answered"
        )
    lines += ["", "[mount]  # of the laser, from the middle of the wheel axis"]
    if mount.x is None:
        lines.append("# x = ...  # m ahead: measure it, there is no usual value")
    else:
        lines.append(f"x = {mount.x}  # m ahead")
    lines += [f"y = {mount.y}  # m to the left", f"theta_deg = {mount.theta_deg}"]
    return "\n".join(lines) + "\n"


def udev_rules(reports: Sequence[ProbeReport], usb: Sequence[UsbPort]) -> str:
    """Return rules that give the devices lasting names, and keep ModemManager away from them.

    Raises:
        RunError: none of them hangs on USB.
    """
    rules = []
    for report in reports:
        itself = os.path.realpath(report.port)
        port = next((p for p in usb if os.path.realpath(p.device) == itself), None)
        if report.kind is None or port is None or port.vid is None or port.pid is None:
            continue
        known = f'ATTRS{{idVendor}}=="{port.vid:04x}", ATTRS{{idProduct}}=="{port.pid:04x}"'
        if port.serial_number:
            known += f', ATTRS{{serial}}=="{_plain(port.serial_number)}"'
        elif port.location:  # an adapter without a number: told by the socket that it is in
            known = f'KERNELS=="{_plain(port.location)}", {known}'
        rules.append(
            f'SUBSYSTEM=="tty", {known}, SYMLINK+="{_NAMES[report.kind]}", GROUP="dialout", '
            'MODE="0660", ENV{ID_MM_DEVICE_IGNORE}="1"'
        )
    if not rules:
        raise RunError("no udev rules: none of these devices is on a USB port of this machine")
    head = "# Copy to /etc/udev/rules.d/, then: udevadm control --reload; udevadm trigger"
    return "\n".join([head, *rules]) + "\n"


def systemd_unit(program: Path, config: Path, runs: Path, user: str) -> str:
    """Return a unit that records and maps from boot on, each start into a folder of its own.

    Raises:
        RunError: a path that a unit cannot hold.
    """
    slam, settings, folder = (_unit_path(path) for path in (program, config, runs))
    return f"""\
# Copy to /etc/systemd/system/slam.service, then: systemctl daemon-reload; systemctl start slam
# It records and maps; it never switches the motors on.
[Unit]
Description=Record and map on the robot
Wants=network-online.target
After=network-online.target

[Service]
Type=exec
User={user}
SupplementaryGroups=dialout
WorkingDirectory={folder}
ExecStart=/bin/sh -c 'exec {slam} online --config {settings} --out {folder}/$(date +%%Y%%m%%dT%%H%%M%%S)'
# SIGTERM ends the drive; finishing the map takes a while. 3: done, but data was lost.
TimeoutStopSec={_STOP_S}
SuccessExitStatus=3 130 143
Restart=on-failure
RestartSec=5
RestartPreventExitStatus=2
CacheDirectory=slam
Environment=NUMBA_CACHE_DIR=/var/cache/slam
NoNewPrivileges=true
PrivateTmp=true
ProtectSystem=full

[Install]
WantedBy=multi-user.target
"""  # noqa: E501


def _unit_path(path: Path) -> str:
    text = str(path.absolute())
    if not all(c.isalnum() or c in "/._-+" for c in text):
        raise RunError(f"{text}: a systemd unit wants a path of letters, digits and . _ - + alone")
    return text


def _plain(text: str) -> str:
    """Refuse what would end the quotes of a rule or of TOML."""
    if not text.isprintable() or set(text) & set('"\\'):
        raise RunError(f"{text!r}: has characters that no port should have")
    return text
