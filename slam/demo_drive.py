"""The demo's drive: a simulated robot and laser on pseudo-terminals, and `slam online` on them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from gtsam import Pose2

from drivers.scip_scan import ScanRequest
from drivers.simulators.drive import dead_reckoning
from drivers.simulators.hokuyo_device import HokuyoDevice
from drivers.simulators.hokuyo_models import MODELS
from drivers.simulators.link import Line
from drivers.simulators.motion import TrackMotion
from drivers.simulators.path import MotionConfig
from drivers.simulators.pioneer_device import PioneerDevice
from drivers.simulators.robot import ODOMETRY_NOISE, drive
from drivers.simulators.servers import PtyEndpoint, SimulatorServer
from drivers.simulators.sweep import Sweeper
from drivers.simulators.worlds import scenario
from slam.config import SlamConfig
from slam.errors import RunError
from slam.robot_config import LaserPort, MountConfig, RobotConfig, RobotPort
from slam.toml_text import toml_text
from slam.trajectory import Trajectory, write_tum

# At 40 scans a second this is the paper's 1.9 cm from scan to scan.
MOTION = MotionConfig(speed=0.76, acceleration=0.5, rest_s=0.5)
_FAR_S = 1e9  # a start that is not yet decided
_READY_S = 150.0  # kernels may have to be compiled first
_MOST_S = 90.0  # after which the online command ends by itself, should we be gone
_CLOSE_S = 60.0


class SimulatedRobot:
    """A P3-DX and a UTM-30LX that share the paper's test bed; it drives when it is told to."""

    def __init__(self, folder: Path, seed: int = 0) -> None:
        bed = scenario("testbed", seed)
        truth = drive(bed.path, MOTION)
        wheels = dead_reckoning(truth, ODOMETRY_NOISE["optimistic"], seed)
        self.motion = TrackMotion(truth, wheels, starts_s=_FAR_S)
        self.base = PioneerDevice(self.motion, world=bed.world)
        sweeper = Sweeper(
            MODELS["utm-30lx"], bed.world, self.motion, base_T_laser=Pose2(), seed=seed
        )
        sweeper.distances(ScanRequest("MD", 0, 1080), 0.0)  # compiles the ray casting
        self.laser = HokuyoDevice(sweeper)
        self.ports = [
            PtyEndpoint(Line(self.base), folder / "p3dx"),
            PtyEndpoint(Line(self.laser, serial=False), folder / "laser"),
        ]

    @property
    def watched(self) -> bool:
        """Whether both devices send."""
        return self.base.sending and self.laser.state == "stream"

    def config(self, settings: SlamConfig) -> RobotConfig:
        """The robot.toml that fits: the paper's 181 beams at 1 degree, all scans."""
        robot, laser = (port.name for port in self.ports)
        return RobotConfig(
            robot=RobotPort(port=robot),
            laser=LaserPort(port=laser, from_deg=-90.0, to_deg=90.0, cluster=4),
            mount=MountConfig(x=0.0),
            slam=settings,
        )

    def true_path(self, began_ns: int) -> Trajectory:
        """Where it was, 50 times a second, in UTC."""
        seconds = np.arange(self.motion.starts_s - 1.0, self.motion.ends_s + 2.0, 0.02)
        stamps = began_ns + np.round(seconds * 1e9).astype(np.int64)
        return Trajectory(stamps, self.motion.truth(seconds))


def drive_online(folder: Path, settings: SlamConfig, say: Callable[[str], None]) -> None:
    """Drive once, watched by `slam online`; leaves `online`, `robot.toml` and `truth.tum`.

    Raises:
        RunError: the online command failed; the message ends with what it said.
    """
    with tempfile.TemporaryDirectory(prefix="slam-demo-") as ports:
        robot = SimulatedRobot(Path(ports))
        config = folder / "robot.toml"
        config.write_text(toml_text(robot.config(settings).model_dump()), encoding="utf-8")
        with SimulatorServer(robot.ports) as server, _online(config, folder, say) as process:
            _wait(lambda: robot.watched, process, _READY_S)
            robot.motion.starts_s = server.now_s + 0.5
            say("driving through the test bed, at 40 scans a second")
            _wait(lambda: server.now_s > robot.motion.ends_s + 0.5, process, _MOST_S)
            process.stop()
            began_ns = server.began_ns
        write_tum(folder / "truth.tum", robot.true_path(began_ns))


class _Process:
    """The online command, and the last thing it said."""

    def __init__(self, command: list[str], say: Callable[[str], None]) -> None:
        root = str(Path(__file__).parents[1])
        path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self.last = ""
        self._say = say
        self._child = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": path}, start_new_session=True,
        )  # fmt: skip
        self._relay = threading.Thread(target=self._listen, daemon=True)
        self._relay.start()

    def _listen(self) -> None:
        for line in self._child.stderr or ():
            self.last = line.strip()
            self._say(f"  online: {self.last}")

    def check(self) -> None:
        """Raise RunError if it has ended."""
        if self._child.poll() is not None:
            self._relay.join(1.0)
            raise RunError(f"slam online has failed: {self.last.removeprefix('slam: ')}")

    def stop(self) -> None:
        """Interrupt it as an operator does, and wait for its RUN.

        Raises:
            RunError: if there is none.
        """
        self._child.send_signal(signal.SIGINT)
        try:
            code = self._child.wait(_CLOSE_S)
        except subprocess.TimeoutExpired as error:
            raise RunError(f"slam online does not end within {_CLOSE_S:.0f} s") from error
        if code != 128 + signal.SIGINT:
            self.check()

    def end(self) -> None:
        """Make sure that it is gone."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
        self._relay.join()
        if self._child.stderr is not None:
            self._child.stderr.close()


@contextmanager
def _online(config: Path, folder: Path, say: Callable[[str], None]) -> Iterator[_Process]:
    process = _Process(
        [sys.executable, "-m", "slam", "online", "--config", str(config),
         "--out", str(folder / "online"), "--seconds", str(_MOST_S)],
        say,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.end()


def _wait(done: Callable[[], bool], process: _Process, most_s: float) -> None:
    end = time.monotonic() + most_s
    while not done():
        process.check()
        if time.monotonic() > end:
            raise RunError(f"slam online is not ready after {most_s:.0f} s")
        time.sleep(0.02)
