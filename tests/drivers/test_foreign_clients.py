"""Programs that know nothing of ours read our simulated devices."""

import contextlib
import threading
import time

import numpy as np
import pytest
from slam.drivers.arcos_protocol import Id
from slam.drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line
from slam.drivers.simulators.motion import CommandedMotion, TrackMotion
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.robot import track_of
from slam.drivers.simulators.servers import PtyEndpoint, SimulatorServer, TcpEndpoint
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.world import World

ROOM = World.from_polygon([(-3, -2), (6, -2), (6, 2), (-3, 3)])


@contextlib.contextmanager
def hokuyo(speed=1.0, **options):
    module = pytest.importorskip("hokuyolx", reason="hokuyolx is not installed")
    track = track_of((0.0, 0.0, 0.0), np.zeros((1, 3)), 1.0)
    sweeper = Sweeper(MODELS["ust-10lx"], ROOM, TrackMotion(track, track))
    device = HokuyoDevice(sweeper, HokuyoBuild(model="ust-10lx", clock_start=123_456))
    endpoint = TcpEndpoint(Line(device, serial=False))
    with SimulatorServer([endpoint], speed, most_step_s=0.005):
        client = module.HokuyoLX(addr=("127.0.0.1", endpoint.port), timeout=3, **options)
        try:
            yield client, device
        finally:
            client._sock.close()  # its own close() wants the sensor's answer


def test_hokuyolx_reads_identity_time_and_state():
    with hokuyo() as (client, device):
        assert client.model == "UST-10LX"
        assert (client.amin, client.amax, client.aforw, client.ares) == (0, 1080, 540, 1440)
        assert client.version()["SERI"] == "H0000001"
        assert client.laser_state()[0] == 3  # lit by its activate()
        now_ms = time.time() * 1000.0 - client.tzero
        assert abs(now_ms - device.count(0.0)) < 60_000
        client.standby()
        assert client.laser_state()[0] == 0


def test_hokuyolx_reads_single_scans():
    with hokuyo(tsync=False, convert_time=False) as (client, _):
        time.sleep(0.1)
        stamp, scan = client.get_dist()
        assert scan.shape == (1081,)
        assert stamp >= 123_456
        assert int(scan[540]) == pytest.approx(
            6000 - 160, abs=60
        )  # unsigned: no difference below 0
        _, bright = client.get_intens(start=180, end=900, grouping=4)
        assert bright.shape == (181, 2)


def test_the_first_scans_of_a_stream_come_one_by_one():
    """The first sweep loads its kernels: the device does that before a client can wait for it."""
    with hokuyo(tsync=False, convert_time=False) as (client, device):
        swept, stream = [], device._sweeper.report

        def timed(*request):
            begin = time.perf_counter()
            lines = stream(*request)
            swept.append(time.perf_counter() - begin)
            return lines

        device._sweeper.report = timed
        client.get_dist()
    assert swept[0] < 0.2  # 0.4 to 0.65 s where they are loaded only then


def test_hokuyolx_reads_a_stream_of_scans():
    # It cannot part replies that come at once, so it gets 0.25 s for each, and none come in a
    # burst when a busy machine has held the simulator up.
    with hokuyo(speed=0.1, tsync=False, convert_time=False) as (client, _):
        rows = list(client.iter_dist(scans=20))
        assert [pending for _, _, pending in rows] == list(range(19, -1, -1))
        steps = np.diff([stamp for _, stamp, _ in rows])
        assert set(steps.tolist()) == {25}
        assert {scan.shape for scan, _, _ in rows} == {(1081,)}


def test_soar_connects_drives_and_says_goodbye():
    arcos = pytest.importorskip("soar.robot.arcos", reason="soar is not installed")
    motion = CommandedMotion()
    device = PioneerDevice(motion, PioneerBuild(baud=115200), ROOM)
    endpoint = PtyEndpoint(Line(device))
    with SimulatorServer([endpoint]):
        client = arcos.ARCOSClient()
        client.connect(forced_ports=[endpoint.name])
        try:
            assert client.standard_event.wait(2.0)
            client.send_command(arcos.ENABLE, 1)
            client.send_command(arcos.VEL, 200)
            client.send_command(arcos.CONFIG)
            assert client.config_event.wait(2.0)
            time.sleep(1.0)
            assert client.config["SUBTYPE"] == "p3dx-sh"
            assert client.standard["XPOS"] > 20
            assert client.standard["L VEL"] == 200
            assert len(client.standard["SONARS"]) == 16
        finally:
            client.disconnect()
            for thread in threading.enumerate():
                if thread not in (threading.main_thread(),) and "simulators" not in thread.name:
                    thread.join(2.0)
        time.sleep(0.1)
        ids = [command.id for command in device.commands]
    assert ids[-2:] == [Id.STOP, Id.CLOSE]
    assert not device.connected
