"""`slam drivers simulate`: a P3-DX and a Hokuyo for whatever program wants to talk to them."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gtsam import Pose2

from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Device, Line
from slam.drivers.simulators.motion import CommandedMotion, Motion, TrackMotion, scenario_motion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.servers import Endpoint, PtyEndpoint, SimulatorServer, TcpEndpoint
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.worlds import Scenario, scenario
from slam.logs.file_lock import hold_folder
from slam.runs.config_file import nearest
from slam.runs.errors import RunError

AHEAD_M = 0.16  # of the laser before the wheel axis
_LOOK_S = 0.1
_FAR_S = 1e9  # a start that is not yet decided
_AFTER_S = 3.0  # from both devices sending to the drive


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatedDevices:
    """What to simulate, and where programs find it."""

    world: str = "office"
    laser: str = "utm-30lx"  # model
    robot: str = "p3dx-sh"  # subclass
    baud: int = 9600  # with which the robot starts
    robot_port: int = 0  # TCP; 0: a pseudo-terminal
    laser_port: int = 0  # TCP; 0: a pseudo-terminal
    drives: bool = False  # by itself, as by joystick; otherwise it obeys its client
    folder: Path | None = None  # of the pseudo-terminals' names; None: a new one

    def serve(self, stop: Callable[[], bool], report: Callable[[str], None]) -> None:
        """Simulate in real time until `stop` says so.

        Raises:
            RunError: no such world or device, or a port is taken.
        """
        motion, place = self._motion()
        try:
            base = PioneerDevice(
                motion, PioneerBuild(subclass=self.robot, baud=self.baud), place.world
            )
            build = HokuyoBuild(model=self.laser)
        except ValueError as error:
            raise RunError(str(error)) from error
        model = MODELS[self.laser]
        sweeper = Sweeper(model, place.world, motion, base_T_laser=Pose2(AHEAD_M, 0.0, 0.0))
        head = HokuyoDevice(sweeper, build)
        with (
            tempfile.TemporaryDirectory(prefix="slam-devices-") as made,
            _claimed(self.folder or Path(made)) as folder,
        ):
            endpoints = [
                _endpoint(base, folder / "p3dx", self.robot_port, serial=not self.robot_port),
                _endpoint(head, folder / "laser", self.laser_port, serial=False),  # as over USB
            ]
            for what, end in zip((self.robot, self.laser), endpoints, strict=True):
                report(f"{what}: {end.name}")
            report(f"laser {AHEAD_M} m ahead of the wheel axis; stop with Ctrl-C")
            with SimulatorServer(endpoints) as server:
                while not stop():
                    time.sleep(_LOOK_S)
                    watched = base.sending and head.state == "stream"
                    if isinstance(motion, TrackMotion) and watched and motion.starts_s == _FAR_S:
                        motion.starts_s = server.now_s + _AFTER_S
                        report(f"driving through the {self.world} in {_AFTER_S:.0f} s")

    def _motion(self) -> tuple[Motion, Scenario]:
        try:
            place = scenario(self.world)
        except ValueError as error:
            raise RunError(str(error)) from error
        if self.laser not in MODELS:
            known = ", ".join(MODELS)
            raise RunError(f"no laser {self.laser!r}{nearest(self.laser, list(MODELS))}: {known}")
        if self.drives:
            return scenario_motion(place, starts_s=_FAR_S), place
        (x, y), (x1, y1) = place.path[0].points[:2]
        return CommandedMotion((x, y, math.atan2(y1 - y, x1 - x))), place


@contextmanager
def _claimed(folder: Path) -> Iterator[Path]:
    """Make the folder of the names and lock it.

    Raises:
        RunError: it cannot be made, or another simulator has its names there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = hold_folder(folder)
    except BlockingIOError as error:
        raise RunError(
            f"{folder}: another simulator has its ports there: choose another --folder"
        ) from error
    except OSError as error:
        raise RunError(f"{folder}: {error.strerror}: choose another --folder") from error
    try:
        yield folder
    finally:
        if handle is not None:
            os.close(handle)


def _endpoint(device: Device, alias: Path, port: int, serial: bool) -> Endpoint:
    line = Line(device, serial=serial)
    try:
        if port:
            return TcpEndpoint(line, port)
        alias.parent.mkdir(parents=True, exist_ok=True)
        return PtyEndpoint(line, alias)
    except OSError as error:
        raise RunError(f"{port or alias}: {error.strerror}") from error
