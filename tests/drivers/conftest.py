"""Captures of foreign programs, and simulated devices on lines in simulated time."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from slam.drivers.hokuyo import Hokuyo, HokuyoConfig
from slam.drivers.pioneer import Pioneer, PioneerConfig
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line, MemoryLink, SimulatedTime
from slam.drivers.simulators.motion import TrackMotion
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.robot import track_of
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.world import World

CAPTURES = Path(__file__).parents[2].parent / "shared" / "data" / "captures"
ROOM = World.from_polygon([(-3, -2), (6, -2), (6, 2), (2, 2), (2, 3), (-3, 3)])


@pytest.fixture
def capture():
    """Read what a real sensor sent (`logr`) or was sent (`logw`)."""

    def read(name):
        path = CAPTURES / name
        if not path.exists():
            pytest.skip(f"no captures of real devices here ({path})")
        return path.read_bytes()

    return read


@pytest.fixture
def dialogue(capture):
    """Read a session between foreign programs: (">" client or "<" device, bytes) in order."""

    def read(name):
        lines = gzip.decompress(capture(name)).decode().splitlines()
        pairs = zip(lines[::2], lines[1::2], strict=True)
        return [(head[0], bytes.fromhex(data.replace(" ", ""))) for head, data in pairs]

    return read


def straight(speed=0.3, seconds=60.0, turn_rate=0.0):
    """Drive a line or an arc with perfect wheels."""
    steps = np.zeros((round(seconds * 50), 3))
    steps[:, 0], steps[:, 2] = speed * 0.02, turn_rate * 0.02
    track = track_of((0.0, 0.0, 0.0), steps, 0.02)
    return TrackMotion(track, track)


class Bench:
    """A session and its simulated device, joined by a line in simulated time."""

    def __init__(self, device, session_type, config, faults=None, serial=True):
        self.time, self.received = SimulatedTime(), []
        self.device, self.line = device, Line(device, faults, serial=serial)
        self.link = MemoryLink(self.line, self.time)
        self.session = session_type(config, self.received.append, self.time, self.link)

    def run(self, seconds):
        end = self.time.now_s + seconds
        while self.time.now_s < end:
            self.session.poll()

    def messages(self, kind):
        return [r.message for r in self.received if isinstance(r.message, kind)]

    def sent(self):
        return b"".join(
            r.message.data for r in self.received if getattr(r.message, "direction", "") == "tx"
        )


@pytest.fixture
def robot_bench():
    """Build a bench around a P3-DX."""

    def build(build=None, faults=None, motion=None, serial=True, **config):
        device = PioneerDevice(motion or straight(), build, ROOM)
        settings = PioneerConfig(port="memory", **config)
        return Bench(device, Pioneer, settings, faults, serial)

    return build


@pytest.fixture
def laser_bench():
    """Build a bench around a Hokuyo."""

    def build(build=None, faults=None, motion=None, serial=False, **config):
        build = build or HokuyoBuild()
        sweeper = Sweeper(MODELS[build.model], ROOM, motion or straight())
        settings = HokuyoConfig(port="memory", **config)
        return Bench(HokuyoDevice(sweeper, build), Hokuyo, settings, faults, serial)

    return build


@pytest.fixture
def standing():
    """Return the motion of a robot that stays where it is."""
    return straight(speed=0.0)
