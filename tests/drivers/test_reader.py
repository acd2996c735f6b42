import queue
import threading
import time

import numpy as np
import pytest
from slam.drivers.connection import DeviceEvent, steady_utc
from slam.drivers.errors import DriverError
from slam.drivers.hokuyo import Hokuyo, HokuyoConfig
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer import Pioneer, PioneerConfig
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.reader import Backoff, DeviceReader
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line, WireFaults
from slam.drivers.simulators.motion import scenario_motion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.servers import PtyEndpoint, SimulatorServer, TcpEndpoint
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.worlds import scenario
from slam.logs.messages import LaserScan, RawBytes, WheelOdometry


def of(kind, received):
    return [r.message for r in received if isinstance(r.message, kind)]


def emptied(inbox):
    items = []
    while not inbox.empty():
        items.append(inbox.get())
    return items


def test_robot_and_laser_on_ptys_share_one_world(tmp_path):
    bed = scenario("testbed-180cm")
    motion = scenario_motion(bed, ODOMETRY_NOISE["none"], starts_s=1.0)
    faults = WireFaults(unplugged=((2.5, 3.2),))
    robot = PtyEndpoint(Line(PioneerDevice(motion, PioneerBuild(), bed.world)), tmp_path / "robot")
    sensor = HokuyoDevice(Sweeper(MODELS["utm-30lx"], bed.world, motion), HokuyoBuild())
    laser = PtyEndpoint(Line(sensor, faults, serial=False), tmp_path / "laser")
    inbox = queue.SimpleQueue()
    with SimulatorServer([robot, laser]):
        readers = [
            DeviceReader(Pioneer(PioneerConfig(port=robot.name), inbox.put), inbox.put),
            DeviceReader(Hokuyo(HokuyoConfig(port=laser.name), inbox.put), inbox.put),
        ]
        for reader in readers:
            reader.start()
        time.sleep(5.0)
        assert all(reader.stop() for reader in readers)
        assert not any(reader.running for reader in readers)
        assert sensor.state == "idle"
    received = emptied(inbox)
    events = [(e.device, e.kind) for e in of(DeviceEvent, received)]
    assert ("p3dx", "connected") in events
    assert [kind for device, kind in events if device == "laser" and kind != "failed"] == [
        "connected", "lost", "resumed", "closed",
    ]  # fmt: skip
    assert readers[1].outages == 1
    scans, wheels = of(LaserScan, received), of(WheelOdometry, received)
    assert len(scans) > 80
    assert len(wheels) > 30
    assert np.all(np.diff([s.stamp_ns for s in scans]) > 0)
    raw = of(RawBytes, received)
    for device, decoder, live in (
        ("laser", HokuyoDecoder(), scans),
        ("p3dx", PioneerDecoder(), wheels),
    ):
        again = [m for r in raw if r.device == device for m in decoder.decode(r)]
        assert [m.stamp_ns for m in again] == [m.stamp_ns for m in live]


def test_stop_does_not_wait_for_a_device_that_is_not_there(tmp_path):
    inbox = queue.SimpleQueue()
    silent = TcpEndpoint(Line(PioneerDevice(scenario_motion(scenario("testbed-180cm")))))
    with SimulatorServer([silent]):
        reader = DeviceReader(Hokuyo(HokuyoConfig(port=silent.name), inbox.put), inbox.put)
        reader.start()
        time.sleep(0.5)
        began = time.monotonic()
        assert reader.stop()
        assert time.monotonic() - began < 1.5
    missing = DeviceReader(Hokuyo(HokuyoConfig(port=str(tmp_path / "no")), inbox.put), inbox.put)
    missing.start()
    time.sleep(0.5)
    assert missing.stop(2.0)
    failed = [e for e in of(DeviceEvent, emptied(inbox)) if e.kind == "failed"]
    assert any("does not exist" in e.detail for e in failed)


class Broken:
    """A session that fails as it is told to."""

    device = "laser"

    def __init__(self, stop_after):
        self.calls, self.closed, self._stop_after = 0, False, stop_after
        self.times, self.reader = [], None

    def connect(self):
        self.calls += 1
        self.times.append(time.monotonic())
        if self.calls == self._stop_after:
            threading.Thread(target=self.reader.stop).start()
        raise DriverError("no")

    def poll(self, timeout_s=0.0):
        raise AssertionError

    def close(self):
        self.closed = True

    def drop(self):
        pass

    def cancel(self):
        pass


def test_the_wait_between_tries_grows():
    session, got = Broken(5), []
    reader = DeviceReader(session, got.append, backoff=Backoff(first_s=0.02, most_s=0.1))
    session.reader = reader
    reader.run()
    waits = np.diff(session.times)
    assert session.closed
    assert waits[0] == pytest.approx(0.02, abs=0.02)
    assert waits[-1] == pytest.approx(0.1, abs=0.05)
    assert [r.message.kind for r in got] == ["failed"] * 5 + ["closed"]


def test_backoff_has_a_ceiling_and_sense():
    assert Backoff().delay_s(1000) == Backoff().most_s
    with pytest.raises(ValueError, match="need"):
        Backoff(first_s=0.0)


def test_the_clock_keeps_its_pace():
    clock = steady_utc()
    assert abs(clock() - time.time_ns()) < 50_000_000
    stamps = [clock() for _ in range(1000)]
    assert stamps == sorted(stamps)


MIXTURES = {
    "flips": WireFaults(flip_rate=5e-5, seed=1),
    "losses": WireFaults(loss_rate=5e-5, seed=2),
    "splits": WireFaults(split=7),
    "merges": WireFaults(hold_s=0.15),
    "delays": WireFaults(delay_s=0.05),
    "silence": WireFaults(silences=((8.0, 9.0), (20.0, 21.8))),
    "unplug": WireFaults(unplugged=((8.0, 9.0), (20.0, 21.8))),
    "all": WireFaults(
        flip_rate=2e-5, loss_rate=2e-5, split=50, delay_s=0.02,
        silences=((8.0, 8.7),), unplugged=((20.0, 21.0),), seed=5,
    ),
}  # fmt: skip


def keep_alive(bench, until_s):
    """What the reader's thread does, in simulated time."""
    connected = False
    while bench.time.now_s < until_s:
        try:
            if not connected:
                bench.session.connect()
                connected = True
            bench.session.poll()
        except DriverError:
            bench.session.drop()
            connected = False
            bench.time.sleep(0.1)
    bench.session.close()


@pytest.mark.parametrize("name", MIXTURES)
def test_odometry_survives_faults_without_a_wrong_pose(robot_bench, name):
    bench = robot_bench(faults=MIXTURES[name])
    keep_alive(bench, 28.0)
    odometry = bench.messages(WheelOdometry)
    assert len(odometry) > 200
    t = np.array([m.stamp_ns for m in odometry]) * 1e-9
    x = np.array([m.x for m in odometry])
    late = x - x[0] - 0.3 * (t - t[0])
    assert np.abs(late).max() < 0.3 * 0.2 + 0.01  # as far as it drives while a packet is late
    assert np.ptp([m.y for m in odometry]) == 0.0
    assert bench.session.decoder.jumps == 0


@pytest.mark.parametrize("name", MIXTURES)
def test_scans_survive_faults_and_every_loss_is_counted(laser_bench, standing, name):
    bench = laser_bench(faults=MIXTURES[name], motion=standing, cluster=4)
    keep_alive(bench, 25.0)
    counters = bench.session.decoder.counters()
    scans = bench.messages(LaserScan)
    assert len(scans) == counters["scans"] > 550
    stamps = np.array([s.stamp_ns for s in scans]) * 1e-9
    assert np.all(np.diff(stamps) > 0)
    errors = np.abs(np.diff(stamps) / 0.025 - np.round(np.diff(stamps) / 0.025)) * 0.025
    assert np.quantile(errors, 0.99) < 0.006
    assert all(np.nanmin(s.ranges) > 1.9 and np.nanmax(s.ranges) < 7.0 for s in scans)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100))
def test_random_mixtures_of_faults(robot_bench, laser_bench, seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(3.0, 30.0)
    faults = WireFaults(
        flip_rate=10.0 ** rng.uniform(-6, -4), loss_rate=10.0 ** rng.uniform(-6, -4),
        split=int(rng.integers(0, 60)), delay_s=rng.uniform(0.0, 0.05),
        silences=((start, start + rng.uniform(0, 2)),),
        unplugged=((start + 5.0, start + 5.0 + rng.uniform(0, 2)),), seed=seed,
    )  # fmt: skip
    for bench, kind in ((robot_bench(faults=faults), WheelOdometry),
                        (laser_bench(faults=faults, cluster=4), LaserScan)):  # fmt: skip
        keep_alive(bench, 50.0)
        stamps = [m.stamp_ns for m in bench.messages(kind)]
        assert len(stamps) > 50
        assert stamps == sorted(stamps)
        if kind is WheelOdometry:
            assert max(m.x for m in bench.messages(kind)) < 0.3 * 50.0
