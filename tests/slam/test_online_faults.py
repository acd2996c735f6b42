"""Robot and laser with faults on their wires, in simulated time: the whole online path but threads.

Each device is read for itself, as its thread would; their messages meet in the intake.
"""

import heapq
import time

import numpy as np
import pytest

from drivers.connection import Received
from drivers.errors import DriverError
from drivers.hokuyo import Hokuyo
from drivers.pioneer import Pioneer
from drivers.simulators.drive import EPOCH_NS
from drivers.simulators.hokuyo_device import HokuyoBuild, HokuyoDevice
from drivers.simulators.hokuyo_models import MODELS
from drivers.simulators.link import Line, MemoryLink, SimulatedTime, WireFaults
from drivers.simulators.motion import scenario_motion
from drivers.simulators.pioneer_device import PioneerBuild, PioneerDevice
from drivers.simulators.sweep import Sweeper
from drivers.simulators.worlds import scenario
from logs.mcap_log import open_log
from logs.messages import LaserScan, WheelOdometry
from logs.recorder import Recorder
from logs.recording import RecorderConfig
from slam.config import SlamConfig
from slam.offline import feed, run_offline
from slam.online_intake import Intake
from slam.pipeline import Slam
from slam.replay import SLAM_TOPICS
from slam.robot_config import LaserPort, MountConfig, RobotPort

STARTS_S, TAIL_S = 4.0, 1.0
NONE = WireFaults()
CONFIG = SlamConfig()


class Drive:
    """One drive through the test bed, read over two faulty wires."""

    def __init__(self, seed, robot=NONE, laser=NONE, base=None, sensor=None):
        bed = scenario("testbed")
        self.motion = scenario_motion(bed, seed=seed, starts_s=STARTS_S)
        self.until_s = self.motion.ends_s + TAIL_S
        base = PioneerDevice(self.motion, base or PioneerBuild())
        sweeper = Sweeper(MODELS["utm-30lx"], bed.world, self.motion, seed=seed)
        head = HokuyoDevice(sweeper, sensor or HokuyoBuild())
        port = LaserPort(port="memory", from_deg=-90, to_deg=90, cluster=4)
        self.robot = self._read(Pioneer, RobotPort(port="memory").driver(), Line(base, robot))
        self.laser = self._read(Hokuyo, port.driver(), Line(head, laser, serial=False))
        self.counters = self.laser[1]

    def _read(self, kind, config, line):
        """What the device's thread does, in its own simulated time."""
        now, received = SimulatedTime(), []
        session = kind(config, received.append, now, MemoryLink(line, now))
        connected = False
        while now.now_s < self.until_s:
            try:
                if not connected:
                    session.connect()
                    connected = True
                session.poll()
            except DriverError:
                session.drop()
                connected = False
                now.sleep(0.1)
        session.close()
        return received, session.decoder.counters()

    def received(self):
        mount = MountConfig(x=0.16).message(EPOCH_NS)
        streams = self.robot[0], self.laser[0]
        return [Received(EPOCH_NS, mount), *heapq.merge(*streams, key=lambda r: r.receipt_ns)]

    def longest_outage_s(self):
        """The longest time without odometry, or without scans, once both were there."""
        gaps = []
        for kind, (received, _) in ((WheelOdometry, self.robot), (LaserScan, self.laser)):
            times = [r.receipt_ns * 1e-9 for r in received if isinstance(r.message, kind)]
            late = [t for t in times if t < EPOCH_NS * 1e-9 + STARTS_S]
            begin = late[-1] if late else EPOCH_NS * 1e-9 + STARTS_S
            end = EPOCH_NS * 1e-9 + self.until_s
            gaps.append(np.diff([begin, *times[len(late) :], end]).max())
        return max(gaps)


def online(drive, path):
    """Record and step, as a live run does; returns the pipeline."""
    slam = Slam(CONFIG)
    with Recorder(path, {}, RecorderConfig(recompress=False, reserve_bytes=0)) as recorder:
        intake = Intake(recorder)
        for received in drive.received():
            while recorder.status().queued > 4000:
                time.sleep(0.001)
            intake(received)
            while (taken := intake.get(0.0)) is not None:
                feed(slam, taken.message)
        slam.finish_input()
    assert not intake.unrecorded
    return slam


def replayed(path):
    def source():
        with open_log(path) as log:
            yield from log.messages(SLAM_TOPICS)

    return run_offline(source, CONFIG)


def error_m(drive, result):
    """Root mean square distance from the truth after the best rigid fit, over all scans."""
    stamps, poses = result.trajectory.stamps_ns, result.trajectory.poses
    truth = drive.motion.truth((stamps - EPOCH_NS) * 1e-9)[:, :2]
    here, there = poses[:, :2] - poses[:, :2].mean(0), truth - truth.mean(0)
    u, _, v = np.linalg.svd(here.T @ there)
    turn = u @ np.diag([1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return float(np.sqrt(((here @ turn - there) ** 2).sum(1).mean()))


def check(drive, path):
    """Run it live and again; what every run must satisfy.  Returns the error of its track."""
    live = online(drive, path)
    again = replayed(path)
    # Batch optimisation rewrites the graph of `again`; the records are as they were entered.
    assert live.scan_stamps_ns == again.slam.scan_stamps_ns
    assert live.odom_poses == again.slam.odom_poses
    assert repr(live.decisions) == repr(again.slam.decisions)
    assert repr(live.estimates) == repr(again.slam.estimates)
    assert live.factors == again.slam.factors[: len(live.factors)]
    assert live.lost == again.lost
    no_wrong_odometry(drive)
    every_scan_is_accounted_for(drive)
    return error_m(drive, again)


def no_wrong_odometry(drive):
    """As far from what the wheels say as the robot drives while a packet is late, or restarts."""
    if drive.robot[1]["odometry_restarts"] or drive.robot[1]["odometry_jumps"]:
        return
    odometry = [r.message for r in drive.robot[0] if isinstance(r.message, WheelOdometry)]
    first = None
    for message in odometry:
        x, y, _ = drive.motion.odometry((message.stamp_ns - EPOCH_NS) * 1e-9)
        off = np.array([message.x - x, message.y - y])
        first = off if first is None else first
        assert np.hypot(*(off - first)) < 0.6 * 0.25 + 0.01


def every_scan_is_accounted_for(drive):
    """From the first scan to the last: those that came and those counted as lost are all."""
    scans = [r.message for r in drive.laser[0] if isinstance(r.message, LaserScan)]
    counters = drive.laser[1]
    assert len(scans) == counters["scans"]
    due = round((scans[-1].stamp_ns - scans[0].stamp_ns) * 1e-9 / 0.025) + 1
    lost = sum(
        n for cause, n in counters.items()
        if cause.startswith("lost_") or cause in ("missing_scans", "outage_scans")
    )  # fmt: skip
    assert len(scans) + lost == pytest.approx(due, abs=3)


def test_a_live_run_and_its_replay_are_the_same_run(tmp_path):
    assert check(Drive(0), tmp_path / "log.mcap") < 0.03


FAULTS = {
    "flips": WireFaults(flip_rate=5e-5, seed=1),
    "silence": WireFaults(silences=((8.0, 9.5),)),
    "unplug": WireFaults(unplugged=((8.0, 9.0), (14.0, 15.0))),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_leave_the_track_and_the_replay_alone(tmp_path, name):
    assert check(Drive(1, FAULTS[name], FAULTS[name]), tmp_path / "log.mcap") < 0.05


def random_faults(rng):
    """One to three kinds of fault on a wire."""
    at = rng.uniform(STARTS_S + 1.0, 16.0)
    window = ((at, at + rng.uniform(0.1, 1.6)),)
    kinds = {
        "flip_rate": 10.0 ** rng.uniform(-6, -4), "loss_rate": 10.0 ** rng.uniform(-6, -4),
        "split": int(rng.integers(1, 60)), "hold_s": rng.uniform(0.0, 0.08),
        "delay_s": rng.uniform(0.0, 0.05), "silences": window, "unplugged": window,
    }  # fmt: skip
    chosen = rng.choice(list(kinds), size=rng.integers(1, 4), replace=False)
    return WireFaults(**{k: kinds[k] for k in chosen}, seed=int(rng.integers(1000)))


def random_drive(seed):
    rng = np.random.default_rng(seed)
    reboot = ((rng.uniform(6.0, 14.0), 0.5),)
    base = PioneerBuild(bad_config_sum=bool(rng.integers(2)), reboots=reboot * (seed % 10 == 8))
    sensor = HokuyoBuild(
        clock_rate=1.0 + rng.uniform(-1e-4, 1e-4), clock_start=int(rng.integers(1 << 24)),
        reboots=reboot * (seed % 10 == 9),
    )  # fmt: skip
    return Drive(seed % 5, random_faults(rng), random_faults(rng), base, sensor)


@pytest.fixture(scope="module")
def usual_error_m(tmp_path_factory):
    """Without faults; the mean over the five drives, which differ by the luck of their noise."""
    folder = tmp_path_factory.mktemp("clean")
    return float(np.mean([check(Drive(k), folder / f"{k}.mcap") for k in range(5)]))


ALONE = {
    **FAULTS,
    "losses": WireFaults(loss_rate=5e-5, seed=2),
    "splits": WireFaults(split=7),
    "merges": WireFaults(hold_s=0.1),
    "delays": WireFaults(delay_s=0.05),
}


@pytest.mark.slow
@pytest.mark.parametrize("where", ["robot", "laser"])
@pytest.mark.parametrize("name", ALONE)
def test_each_fault_alone(tmp_path, usual_error_m, name, where):
    drive = Drive(2, **{where: ALONE[name]})
    assert check(drive, tmp_path / "log.mcap") < 2.0 * usual_error_m


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_campaign(tmp_path, usual_error_m, seed):
    drive = random_drive(seed)
    found = check(drive, tmp_path / "log.mcap")
    if drive.longest_outage_s() < 2.0:
        assert found < 2.0 * usual_error_m
