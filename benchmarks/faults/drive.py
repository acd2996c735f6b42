"""A drive of simulated devices with faults, in simulated time: the online path but threads.

Each device is read by its own `DeviceReader`, as its thread would; their messages meet in the
message sequencer, in the order of receipt.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from slam.drivers.connection import Clock, Received, Sink
from slam.drivers.hokuyo import Hokuyo
from slam.drivers.pioneer import Pioneer
from slam.drivers.ports import Port
from slam.drivers.reader import DeviceReader
from slam.drivers.scip_scan import ScanRequest, ranges_m
from slam.drivers.simulators.drive import EPOCH_NS
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line, MemoryLink, SimulatedTime, WireFaults
from slam.drivers.simulators.motion import scenario_motion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.sweep import Integers, Sweeper, clustered
from slam.drivers.simulators.worlds import scenario
from slam.logs.recorder import Recorder
from slam.logs.recording import RecorderConfig

from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.online.robot_config import LaserPort, MountConfig, RobotPort
from slam.online.sequencer import MessageSequencer
from slam.runs.offline import feed

_STANDS_S = 3.0  # s, at most, until a robot that has restarted goes on
STARTS_S, TAIL_S = 8.0, 1.0  # s of standing still before and after the drive
Opener = Callable[[str, int], Port]
Kind = TypeVar("Kind")
_QUEUE = 4000  # messages; a disk that is slower than simulated time must not lose any


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveFaults:
    """All that goes wrong on one drive."""

    robot: WireFaults = field(default_factory=WireFaults)
    laser: WireFaults = field(default_factory=WireFaults)
    base: PioneerBuild = field(default_factory=PioneerBuild)
    sensor: HokuyoBuild = field(default_factory=HokuyoBuild)
    wheels: tuple[OdometryFault, ...] = ()  # times count from the start of the drive


class _Memory(Sweeper):
    """Remembers what it measured, to tell scans that were never sent from those that were."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.sent: dict[bytes, float] = {}  # ranges as in a scan, and s of simulation

    def distances(self, request: ScanRequest, starts_s: float) -> Integers:
        """See `Sweeper`."""
        found = super().distances(request, starts_s)
        ranges = ranges_m(clustered(found, request.cluster), self.model.parameters, np.inf)
        self.sent[ranges.tobytes()] = starts_s + request.start * self.model.parameters.step_s
        return found


class FaultyDrive:
    """One drive through the test bed, read over two faulty wires; all of it when it is built."""

    def __init__(
        self, seed: int, faults: DriveFaults | None = None, laser_seed: int | None = None,
        world: str = "testbed",
    ) -> None:  # fmt: skip
        """Draw the noise of the wheels from `seed`, and the laser's unless it has its own."""
        faults = faults or DriveFaults()
        laser_seed = seed if laser_seed is None else laser_seed
        bed = scenario(world)
        self.motion = scenario_motion(bed, seed=seed, faults=faults.wheels, starts_s=STARTS_S)
        standing_s = _STANDS_S * len(faults.base.reboots)
        self.until_s = self.motion.ends_s + standing_s + TAIL_S
        self.base = PioneerDevice(self.motion, faults.base)
        self.sweeper = _Memory(MODELS["utm-30lx"], bed.world, self.motion, seed=laser_seed)
        self.head = HokuyoDevice(self.sweeper, faults.sensor)
        robot = RobotPort(port="memory").driver()
        laser = LaserPort(port="memory", from_deg=-90, to_deg=90, cluster=4).driver()
        self.robot = _read(
            lambda *ends: Pioneer(robot, *ends), self.until_s, Line(self.base, faults.robot)
        )
        self.laser = _read(
            lambda *ends: Hokuyo(laser, *ends), self.until_s,
            Line(self.head, faults.laser, serial=False),
        )  # fmt: skip

    def received(self) -> list[Received]:
        """All that both threads hand over, in one order."""
        extrinsics = MountConfig(x=0.16).message(EPOCH_NS)
        streams = self.robot.received, self.laser.received
        return [Received(EPOCH_NS, extrinsics), *heapq.merge(*streams, key=lambda r: r.receipt_ns)]

    def record(self, path: Path, config: SlamConfig) -> tuple[Slam, MessageSequencer]:
        """Record and step, as a live run does."""
        settings = RecorderConfig(recompress=False, reserve_bytes=0)
        with Recorder(path, {}, settings) as recorder, ThreadPoolExecutor(1) as loops:
            slam = Slam(config, submit=loops.submit)
            sequencer = MessageSequencer(recorder)
            for received in self.received():
                while recorder.status().queued > _QUEUE:
                    time.sleep(0.001)
                sequencer(received)
                while (taken := sequencer.get(0.0)) is not None:
                    feed(slam, taken.message)
            slam.finish_input()
        return slam, sequencer


@dataclass(frozen=True, eq=False, slots=True)
class Reading:
    """What the thread of one device did until the drive was over, in its own simulated time."""

    line: Line
    received: list[Received]
    ended_s: float  # when it had closed its device
    outages: int
    connections: int
    counters: dict[str, int]

    def messages(self, kind: type[Kind]) -> list[Kind]:
        """The messages of one kind, in order."""
        return [r.message for r in self.received if isinstance(r.message, kind)]


def _read(
    session_on: Callable[[Sink, Clock, Opener], Pioneer | Hokuyo], until_s: float, line: Line
) -> Reading:
    now, received = SimulatedTime(), list[Received]()
    session = session_on(received.append, now, MemoryLink(line, now))
    reader = DeviceReader(session, received.append, clock=now, stop=_Until(now, until_s))
    reader.run()
    counters = session.decoder.counters()
    return Reading(line, received, now.now_s, reader.outages, reader.connections, counters)


class _Until:
    """Ends a reader at a time of simulation, and lets that time pass where it waits."""

    def __init__(self, now: SimulatedTime, until_s: float) -> None:
        self._now, self._until_s = now, until_s

    def is_set(self) -> bool:
        """See `Waiter`."""
        return self._now.now_s >= self._until_s

    def set(self) -> None:
        """See `Waiter`."""
        self._until_s = -np.inf

    def wait(self, timeout: float) -> bool:
        """See `Waiter`."""
        self._now.sleep(timeout)
        return self.is_set()
