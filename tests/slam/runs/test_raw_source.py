"""`--from raw`: the drivers' decoders on recorded bytes, against what they gave live."""

import hashlib
import heapq
import json
import math

import numpy as np
import pytest
from slam.drivers.connection import DeviceEvent
from slam.drivers.errors import DriverError
from slam.drivers.hokuyo import Hokuyo
from slam.drivers.pioneer import Pioneer
from slam.drivers.simulators.drive import EPOCH_NS
from slam.drivers.simulators.hokuyo_device import HokuyoDevice
from slam.drivers.simulators.hokuyo_models import MODELS
from slam.drivers.simulators.link import Line, MemoryLink, SimulatedTime, WireFaults
from slam.drivers.simulators.motion import scenario_motion
from slam.drivers.simulators.pioneer_device import PioneerDevice
from slam.drivers.simulators.sweep import Sweeper
from slam.drivers.simulators.worlds import scenario
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import LaserScan, WheelOdometry
from slam.logs.part_writer import PartWriter, RotationConfig
from slam.logs.parts import Recording
from slam.logs.schemas import encode, topic_of

from slam.online.robot_config import LaserPort, MountConfig, RobotConfig, RobotPort
from slam.runs.config_file import load_config
from slam.runs.raw_source import decoders, messages_from_raw
from slam.runs.replay import SLAM_TOPICS, replay

CONFIG = RobotConfig(
    robot=RobotPort(port="memory", model="p3dx-sh"),
    laser=LaserPort(port="memory", from_deg=-90, to_deg=90, cluster=4, reach_m=4.0),
    mount=MountConfig(x=0.16),
)
FAULTS = {
    "none": (None, None),
    "threads": (None, None),  # that overtake each other on the way into the log
    "damage": (
        WireFaults(flip_rate=2e-4, delay_s=0.03, seed=1),
        WireFaults(flip_rate=2e-5, loss_rate=1e-5, split=100, seed=2),
    ),
    "outage": (WireFaults(silences=((5.0, 6.5),)), WireFaults(unplugged=((6.0, 6.8),))),
}


def read(kind, config, line, until_s):
    """What a device's thread does, in simulated time."""
    now, received = SimulatedTime(), []
    session = kind(config, received.append, now, MemoryLink(line, now))
    connected = False
    while now.now_s < until_s:
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
    return [r for r in received if not isinstance(r.message, DeviceEvent)]


@pytest.fixture(scope="module", params=FAULTS)
def recording(request, tmp_path_factory):
    """A log as `slam online` records it."""
    robot_faults, laser_faults = FAULTS[request.param]
    bed = scenario("testbed-180cm")
    motion = scenario_motion(bed, starts_s=4.0)
    base = Line(PioneerDevice(motion), robot_faults)
    head = Line(
        HokuyoDevice(Sweeper(MODELS["utm-30lx"], bed.world, motion)), laser_faults, serial=False
    )
    streams = (
        read(Pioneer, CONFIG.robot.driver(), base, motion.ends_s),
        read(Hokuyo, CONFIG.laser.driver(), head, motion.ends_s),
    )
    path = tmp_path_factory.mktemp(request.param) / "drive.mcap"
    with LogWriter(path) as log:
        log.add_attachment("robot.json", CONFIG.model_dump_json(exclude={"slam"}).encode(), "")
        log.write(CONFIG.mount.message(EPOCH_NS))
        late_ns = 30_000_000 if request.param == "threads" else 0
        received = heapq.merge(*streams, key=lambda r: r.receipt_ns)
        in_log = sorted(
            received, key=lambda r: r.receipt_ns + late_ns * isinstance(r.message, LaserScan)
        )
        for receipt_ns, message in in_log:
            log.write(message, receipt_ns)
    return path


def channels(messages):
    found = {}
    for message in messages:
        found.setdefault(topic_of(message), []).append((message.stamp_ns, encode(message)))
    return found


def test_raw_bytes_give_the_logged_messages_to_the_last_byte(recording):
    lost = {}
    with open_log(recording) as log:
        decoded = channels(log.messages(SLAM_TOPICS))
    anew = channels(messages_from_raw(Recording(recording), lost))
    assert anew == decoded
    assert len(decoded["/scan"]) > 100
    assert len(decoded["/odom"]) > 50
    assert bool(lost) == recording.parent.name.startswith(("damage", "outage"))


def test_both_replays_are_the_same_run(recording, tmp_path):
    config = load_config(None)
    replay(recording, tmp_path / "decoded", config)
    replay(recording, tmp_path / "raw", config, from_raw=True)
    for name in ("trajectory.tum", "keyframes.tum", "odometry.tum", "graph.g2o", "map.pgm"):
        first, second = (
            hashlib.sha256((tmp_path / run / name).read_bytes()).hexdigest()
            for run in ("decoded", "raw")
        )
        assert first == second, name


def log_with(path, settings, name="robot.json"):
    with LogWriter(path) as log:
        log.add_attachment(name, settings, "application/json")
        log.write(CONFIG.mount.message(EPOCH_NS))
    return path


@pytest.mark.parametrize(
    "settings",
    [b"", b"\xff", b"[]", b"{}", b"[" * 100_000, b'{"robot": {"model": "x"}, "laser": {}}',
     b'{"robot": {"model": "p3dx"}, "laser": {"reach_m": -1}}',
     b'{"robot": {"model": []}, "laser": {"reach_m": NaN}}'],
)  # fmt: skip
def test_settings_that_cannot_be_read_are_refused(tmp_path, settings):
    path = log_with(tmp_path / "x.mcap", settings)
    with pytest.raises(LogError, match=r"robot\.json cannot be read"):
        decoders(Recording(path))


def test_a_reach_without_limit_and_the_robots_own_model(tmp_path):
    settings = json.dumps({"robot": {"model": "auto"}, "laser": {"reach_m": None}}).encode()
    for name in ("robot.json", "other.json"):
        log = log_with(tmp_path / "x.mcap", settings, name)
        robot, laser = decoders(Recording(log))
        assert robot.model is None
        assert laser._reach_m == math.inf


def test_a_log_without_raw_bytes_says_so(tmp_path):
    with LogWriter(tmp_path / "x.mcap") as log:
        log.write(WheelOdometry(EPOCH_NS, 0.0, 0.0, 0.0))
        log.write(LaserScan(EPOCH_NS, 0.0, 0.1, np.ones(9, dtype=np.float32), 0.0, 30.0))
    with pytest.raises(LogError, match="no raw bytes"):
        list(messages_from_raw(Recording(tmp_path / "x.mcap"), {}))


@pytest.fixture
def parts(recording, tmp_path):
    """The same recording in files of a quarter of its size."""
    rotation = RotationConfig(bytes=recording.stat().st_size // 4)
    with open_log(recording) as log:
        writer = PartWriter(tmp_path / "part.mcap", {"id": "1"}, rotation)
        for attached in log.attachments():
            writer.add(attached)
        for k, (receipt_ns, message) in enumerate(log.receipts()):
            writer.write(message, receipt_ns)
            if k % 100 == 0:
                writer.tick()
        writer.close()
    assert len(writer.files) >= 3
    return writer.files


def test_a_recording_in_parts_is_the_same_run_from_decoded_and_from_raw(recording, parts, tmp_path):
    config, lost = load_config(None), {}
    whole = channels(Recording(recording).messages(SLAM_TOPICS))
    assert channels(Recording(parts[0]).messages(SLAM_TOPICS)) == whole
    assert channels(messages_from_raw(Recording(parts[0]), lost)) == whole
    summary = replay(parts[0], tmp_path / "parts", config, from_raw=True)
    replay(recording, tmp_path / "whole", config)
    for name in ("trajectory.tum", "graph.g2o", "map.pgm"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    blocks = b"".join(path.read_bytes() for path in parts)
    assert summary["log_sha256"] == hashlib.sha256(blocks).hexdigest()


def test_a_later_part_serves_alone_but_not_its_raw_bytes(parts):
    later = Recording(parts[1])
    kinds = {topic_of(m) for m in later.messages(SLAM_TOPICS)}
    assert kinds == {"/scan", "/odom", "/tf"}
    with pytest.raises(LogError, match="later part"):
        list(messages_from_raw(later, {}))


def test_a_missing_part_is_a_loss_and_foreign_files_are_no_parts(parts):
    parts[1].unlink()
    with LogWriter(parts[0].with_name("part_999.mcap"), {"id": "2", "part": "999"}) as log:
        log.write(WheelOdometry(EPOCH_NS, 0.0, 0.0, 0.0))
    rest = Recording(parts[0])
    assert rest.files == [parts[0], *parts[2:]]
    list(rest.messages())
    assert rest.skipped == {"part 1 is missing": 1}
    assert Recording(parts[0].with_name("part_999.mcap")).files == [
        parts[0].with_name("part_999.mcap")
    ]
