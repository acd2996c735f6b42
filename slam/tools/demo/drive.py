"""A drive of a simulated robot and laser on pseudo-terminals, watched by `slam online`."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w
from gtsam import Pose2

from slam.drivers.simulators.drive import dead_reckoning
from slam.drivers.simulators.hokuyo_device import HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line
from slam.drivers.simulators.motion import TrackMotion
from slam.drivers.simulators.path import MotionConfig
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.robot import ODOMETRY_NOISE, drive, to_and_fro
from slam.drivers.simulators.servers import PtyEndpoint, SimulatorServer
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.worlds import scenario
from slam.logs.trajectory import Trajectory, write_tum
from slam.mapping.config import SlamConfig
from slam.online.robot_config import LaserPort, MountConfig, RobotConfig, RobotPort
from slam.runs.errors import RunError

_FAR_S = 1e9  # a start that is not yet decided
_READY_S = 150.0  # kernels may have to be compiled first
_CLOSE_S = 60.0  # and as long again as the drive: every scan is matched once more


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """Where to drive and how to look; all scans are asked for, 40 a second."""

    world: str = "testbed"
    motion: MotionConfig = field(default_factory=MotionConfig)
    noise: str = "typical"
    ahead_m: float = 0.16  # of the laser before the wheel axis
    from_deg: float = -180.0
    to_deg: float = 180.0
    cluster: int = 1
    passes: int = 1  # there, back in reverse, there again ...
    seed: int = 0
    most_s: float = 90.0  # after which the online command ends by itself, should we be gone


# The paper's 181 beams at 1 degree and, at that speed, its 1.9 cm from scan to scan.
PAPER = Plan(
    motion=MotionConfig(speed=0.76, acceleration=0.5, rest_s=0.5),
    noise="optimistic", ahead_m=0.0, from_deg=-90.0, to_deg=90.0, cluster=4,
)  # fmt: skip


class SimulatedRobot:
    """A P3-DX and a UTM-30LX that share a world; the robot drives on command."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.plan, seed = plan, plan.seed
        bed = scenario(plan.world, seed)
        truth = to_and_fro(drive(bed.path, plan.motion), plan.passes)
        wheels = dead_reckoning(truth, ODOMETRY_NOISE[plan.noise], seed)
        self.motion = TrackMotion(truth, wheels, starts_s=_FAR_S)
        self.base = PioneerDevice(self.motion, world=bed.world)
        sweeper = Sweeper(
            MODELS["utm-30lx"], bed.world, self.motion,
            base_T_laser=Pose2(plan.ahead_m, 0.0, 0.0), seed=seed,
        )  # fmt: skip
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
        """The robot.toml that fits."""
        robot, laser = (port.name for port in self.ports)
        plan = self.plan
        return RobotConfig(
            robot=RobotPort(port=robot),
            laser=LaserPort(
                port=laser, from_deg=plan.from_deg, to_deg=plan.to_deg, cluster=plan.cluster
            ),
            mount=MountConfig(x=plan.ahead_m),
            slam=settings,
        )

    def true_path(self, began_ns: int) -> Trajectory:
        """Where it was, 50 times a second, in UTC."""
        seconds = np.arange(self.motion.starts_s - 1.0, self.motion.ends_s + 2.0, 0.02)
        stamps = began_ns + np.round(seconds * 1e9).astype(np.int64)
        return Trajectory(stamps, self.motion.truth(seconds))


def drive_online(
    folder: Path, settings: SlamConfig, echo: Callable[[str], None], plan: Plan = PAPER
) -> None:
    """Drive once, watched by `slam online`; leaves `online`, `robot.toml` and `truth.tum`.

    Raises:
        RunError: the online command failed; the message ends with what it said.
    """
    with tempfile.TemporaryDirectory(prefix="slam-demo-") as ports:
        robot = SimulatedRobot(Path(ports), plan)
        config = folder / "robot.toml"
        written = robot.config(settings).model_dump(exclude_none=True)
        config.write_text(tomli_w.dumps(written), encoding="utf-8")
        with (
            SimulatorServer(robot.ports) as server,
            _online(config, folder, echo, plan.most_s) as process,
        ):
            _wait(lambda: robot.watched, process, _READY_S)
            robot.motion.starts_s = server.now_s + 0.5
            duration_s = robot.motion.ends_s - server.now_s
            echo(f"driving through the {plan.world} for {duration_s:.0f} s, at 40 scans a second")
            _wait(lambda: server.now_s > robot.motion.ends_s + 0.5, process, plan.most_s)
            process.stop(_CLOSE_S + duration_s)
            began_ns = server.began_ns
        write_tum(folder / "truth.tum", robot.true_path(began_ns))


class _Process:
    """The online command, and its last message."""

    def __init__(self, command: list[str], echo: Callable[[str], None]) -> None:
        self.last = ""
        self._echo = echo
        self._child = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        self._relay = threading.Thread(target=self._listen, daemon=True)
        self._relay.start()

    def _listen(self) -> None:
        for line in self._child.stderr or ():
            self.last = line.strip()
            self._echo(f"  online: {self.last}")

    def check(self) -> None:
        """Raise RunError if it has ended."""
        if self._child.poll() is not None:
            self._relay.join(1.0)
            raise RunError(f"slam online has failed: {self.last.removeprefix('slam: ')}")

    def stop(self, most_s: float) -> None:
        """Interrupt it as an operator does, and wait for its RUN.

        Raises:
            RunError: if there is none.
        """
        self._child.send_signal(signal.SIGINT)
        try:
            code = self._child.wait(most_s)
        except subprocess.TimeoutExpired as error:
            raise RunError(f"slam online does not end within {most_s:.0f} s") from error
        if code != 128 + signal.SIGINT:
            self.check()

    def end(self) -> None:
        """Make sure that it has ended."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
        self._relay.join()
        if self._child.stderr is not None:
            self._child.stderr.close()


@contextmanager
def _online(
    config: Path, folder: Path, echo: Callable[[str], None], most_s: float
) -> Iterator[_Process]:
    process = _Process(
        [sys.executable, "-m", "slam", "online", "--config", str(config),
         "--out", str(folder / "online"), "--seconds", str(most_s)],
        echo,
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
