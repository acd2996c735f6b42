from __future__ import annotations

import math
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from slam.logs.errors import LogError
from slam.logs.exporters import ros2_messages as ros
from slam.logs.exporters.ros2 import write_ros2
from slam.logs.importers.detect import read_any
from slam.logs.importers.imported import StreamedLog
from slam.logs.importers.rosbag import read_rosbag
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import (
    DeviceHealth,
    FactorRecord,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    Message,
    OccupancyMap,
    PoseEstimate,
    TruePose,
    WheelOdometry,
)

START = 1_700_000_000_000_000_000
STEP = 100_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)


def a_run(n: int = 20) -> list[Message]:
    rng = np.random.default_rng(3)
    messages: list[Message] = [LaserExtrinsics(START, 0.16, 0.02, 0.1)]
    for k in range(n):
        stamp = START + k * STEP
        ranges = rng.uniform(0.5, 9.0, 181).astype(np.float32)
        ranges[3], ranges[7] = np.inf, np.nan
        messages += [
            WheelOdometry(stamp, 0.1 * k, -0.01 * k, 0.02 * k),
            TruePose(stamp, 0.1 * k, 0.0, 0.02 * k),
            LaserScan(stamp, -1.5, 3.0 / 180, ranges, 0.1, 10.0, 1e-4),
            PoseEstimate(stamp, 0.1 * k, 0.0, 0.02 * k, tuple(float(i) for i in range(9))),
        ]
    cells = rng.integers(-1, 101, (7, 5)).astype(np.int8)
    factor = FactorRecord(START, "icp", 0, 1, 0.0, 0.0, 0.0, (0.0,) * 9)
    messages += [
        LogLine(START, "error", "laser", "lost: no scan for 1.0 s"),
        DeviceHealth(START, "laser", "lost", ("scans", "clock_drift_ppm"), ("20", "-3")),
    ]
    return [*messages, OccupancyMap(START, 0.05, -1.0, -2.0, cells), factor]


def received(messages: list[Message], delay_ns: int = 5_000_000):
    return [(m.stamp_ns + delay_ns, m) for m in messages]


def read(log: StreamedLog) -> list[Message]:
    return [message for message, _ in log.received()]


def test_every_message_of_the_export_is_read_back_by_rosbags(tmp_path: Path):
    run = a_run()
    export = write_ros2(tmp_path / "bag", received(run))
    assert export.written == {
        "/scan": 20, "/odom": 20, "/truth": 20, "/tf": 40, "/tf_static": 2, "/pose": 20,
        "/map": 1, "/path": 1, "/rosout": 1, "/diagnostics": 1,
    }  # fmt: skip
    assert export.skipped == {"/factor: has no standard type in ROS": 1}
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    types = STORE.types
    wanted = {
        "/scan": [m for m in run if isinstance(m, LaserScan)],
        "/odom": [m for m in run if isinstance(m, WheelOdometry)],
        "/truth": [m for m in run if isinstance(m, TruePose)],
        "/pose": [m for m in run if isinstance(m, PoseEstimate)],
        "/map": [m for m in run if isinstance(m, OccupancyMap)],
        "/tf_static": [m for m in run if isinstance(m, LaserExtrinsics)],
        "/rosout": [m for m in run if isinstance(m, LogLine)],
        "/diagnostics": [m for m in run if isinstance(m, DeviceHealth)],
    }
    made = {
        "/scan": lambda m: ros.scan(types, m, 0.0 if m.stamp_ns == START else 0.1),
        "/odom": lambda m: ros.odometry(types, m),
        "/truth": lambda m: ros.odometry(types, m),
        "/pose": lambda m: ros.estimate(types, m),
        "/map": lambda m: ros.occupancy(types, m),
        "/tf_static": lambda m: ros.extrinsics(types, m),
        "/rosout": lambda m: ros.log_line(types, m),
        "/diagnostics": lambda m: ros.diagnostics(types, m),
    }
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == sum(export.written.values())
        got: dict[str, list[bytes]] = {}
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            again = reader.typestore.serialize_cdr(message, connection.msgtype)
            assert bytes(again) == bytes(data)
            got.setdefault(connection.topic, []).append(bytes(data))
            assert time_ns >= START + 5_000_000
            durability = connection.ext.offered_qos_profiles[0].durability.name
            static = connection.topic in ("/tf_static", "/map", "/path")
            assert durability == ("TRANSIENT_LOCAL" if static else "VOLATILE")
        world = reader.deserialize(got["/tf_static"].pop(), "tf2_msgs/msg/TFMessage").transforms[0]
        assert (world.header.frame_id, world.child_frame_id) == ("map", "world")
        for topic, messages in wanted.items():
            kinds = {c.topic: c.msgtype for c in reader.connections}
            assert got[topic] == [
                bytes(STORE.serialize_cdr(made[topic](m), kinds[topic])) for m in messages
            ]
        (path,) = got["/path"]
        read = reader.deserialize(path, "nav_msgs/msg/Path")
        assert len(read.poses) == 20
        line = reader.deserialize(got["/rosout"][0], "rcl_interfaces/msg/Log")
        assert (line.level, line.name, line.msg) == (40, "laser", "lost: no scan for 1.0 s")
        array = reader.deserialize(got["/diagnostics"][0], "diagnostic_msgs/msg/DiagnosticArray")
        (status,) = array.status
        assert (status.level, status.name, status.message) == (2, "laser", "lost")
        assert [(v.key, v.value) for v in status.values] == [
            ("scans", "20"), ("clock_drift_ppm", "-3"),
        ]  # fmt: skip


def test_transforms_lead_from_map_to_laser(tmp_path: Path):
    messages = [WheelOdometry(START, 1.0, 2.0, 0.5), PoseEstimate(START, 3.0, -1.0, 1.5)]
    write_ros2(tmp_path / "bag", received(messages))
    with AnyReader([tmp_path / "bag"]) as reader:
        transforms = [
            reader.deserialize(data, connection.msgtype).transforms[0]
            for connection, _, data in reader.messages()
            if connection.topic == "/tf"
        ]
    placed = [
        (
            t.transform.translation.x,
            t.transform.translation.y,
            2 * math.asin(t.transform.rotation.z),
        )
        for t in transforms
    ]
    (x1, y1, a1), (x2, y2, a2) = placed[1], placed[0]
    c, s = math.cos(a1), math.sin(a1)
    composed = (x1 + c * x2 - s * y2, y1 + s * x2 + c * y2, a1 + a2)
    assert composed == pytest.approx((3.0, -1.0, 1.5))


def test_the_covariance_is_turned_into_the_frame_of_the_map():
    estimate = PoseEstimate(START, 0.0, 0.0, math.pi / 2, (4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0, 0, 9.0))
    full = ros.estimate(STORE.types, estimate).pose.covariance.reshape(6, 6)
    assert np.diag(full) == pytest.approx([1.0, 4.0, 0.0, 0.0, 0.0, 9.0])


def test_an_export_comes_back_through_the_importer(tmp_path: Path):
    run = a_run()
    write_ros2(tmp_path / "bag", received(run))
    for source in (tmp_path / "bag", tmp_path / "bag" / "bag.mcap"):
        log = read_any(source)
        assert log.kind == "ROS bag"
        assert not log.skipped
        extrinsics, *rest = read(log)
        assert (extrinsics.x, extrinsics.y, extrinsics.theta) == pytest.approx((0.16, 0.02, 0.1))
        wanted = [m for m in run if isinstance(m, LaserScan | WheelOdometry)]
        assert [(type(m), m.stamp_ns) for m in rest] == [(type(m), m.stamp_ns) for m in wanted]
        assert all(receipt == m.stamp_ns + 5_000_000 for m, receipt in list(log.received())[1:])
        for got, message in zip(rest, wanted, strict=True):
            if isinstance(message, LaserScan):
                assert got.ranges.tobytes() == message.ranges.tobytes()
                assert got.angle_min == pytest.approx(message.angle_min)
                assert got.beam_period_s == pytest.approx(1e-4)
            else:
                assert (got.x, got.y, got.theta) == pytest.approx(
                    (message.x, message.y, message.theta)
                )
        assert log.ignored["/truth (nav_msgs/msg/Odometry)"] == 20


def write_bag(path: Path, plugin: StoragePlugin, laser: str = "laser", roll: float = 0.0) -> None:
    """Write a bag with two lasers; the front one hangs upside down for a roll of pi."""
    types = STORE.types
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        add = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in [
                ("/front/scan", "sensor_msgs/msg/LaserScan"),
                ("/rear/scan", "sensor_msgs/msg/LaserScan"),
                ("/wheel_odom", "nav_msgs/msg/Odometry"),
                ("/tf_static", "tf2_msgs/msg/TFMessage"),
            ]
        }

        def put(topic: str, kind: str, time_ns: int, message: object) -> None:
            writer.write(add[topic], time_ns, STORE.serialize_cdr(message, kind))

        chain = ros.transform(types, START, "base_link", "plate", (0.1, 0.0, 0.5))
        upside = ros.transform(types, START, "plate", laser, (0.2, 0.0, 0.0))
        turn = types["geometry_msgs/msg/Quaternion"](
            x=math.sin(roll / 2), y=0.0, z=0.0, w=math.cos(roll / 2)
        )
        upside.transforms[0].transform.rotation = turn
        for message in (chain, upside):
            put("/tf_static", "tf2_msgs/msg/TFMessage", START, message)
        ranges = np.arange(1, 11, dtype=np.float32)
        for k in range(6):
            stamp = START + (k if k != 4 else 2) * STEP  # one runs backwards, to a stamp again
            scan = ros.scan(types, LaserScan(stamp, -0.5, 0.1, ranges, 1.5, 10.0), 0.1)
            put("/front/scan", "sensor_msgs/msg/LaserScan", START + k * STEP, scan)
            if k < 2:
                put("/rear/scan", "sensor_msgs/msg/LaserScan", START + k * STEP, scan)
            odometry = ros.odometry(types, WheelOdometry(START + k * STEP, 0.1 * k, 0.0, 0.0))
            put("/wheel_odom", "nav_msgs/msg/Odometry", START + k * STEP, odometry)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_foreign_bag_with_two_lasers(tmp_path: Path, plugin: StoragePlugin):
    write_bag(tmp_path / "bag", plugin)
    log = read_any(tmp_path / "bag")
    scans = [m for m in read(log) if isinstance(m, LaserScan)]
    assert len(scans) == 6
    assert [m.stamp_ns for m in scans] == sorted(m.stamp_ns for m in scans)
    assert log.ignored == {"/rear/scan (another laser)": 2}
    assert log.changed == {
        "stamps that ran backwards, put in order": 1,
        "scans with the stamp of another, kept": 1,
    }
    assert np.isnan(scans[0].ranges[0])  # nearer than 1.5 m
    assert np.isinf(scans[0].ranges[9])  # from the reach on
    extrinsics = read(log)[0]
    expected = (0.1 + 0.2 * math.cos(0.5), 0.2 * math.sin(0.5), 0.5)
    assert (extrinsics.x, extrinsics.y, extrinsics.theta) == pytest.approx(expected)
    rear = read_rosbag(tmp_path / "bag", Wishes(scan="/rear/scan"))
    assert sum(isinstance(m, LaserScan) for m in read(rear)) == 2
    with pytest.raises(LogError, match=r"no LaserScan on /x\\x1b"):
        read_rosbag(tmp_path / "bag", Wishes(scan="/x\x1b"))


def test_a_laser_that_hangs_upside_down_is_mirrored(tmp_path: Path):
    write_bag(tmp_path / "bag", StoragePlugin.MCAP, roll=math.pi)
    log = read_any(tmp_path / "bag")
    scan = next(m for m in read(log) if isinstance(m, LaserScan))
    assert (scan.angle_min, scan.angle_step) == pytest.approx((0.5, -0.1))
    assert read(log)[0].theta == pytest.approx(0.5)


def test_a_ros_1_bag_without_transforms(tmp_path: Path):
    path = tmp_path / "a.bag"
    kind = "sensor_msgs/msg/LaserScan"
    types = STORE1.types
    with Writer1(path) as writer:
        connection = writer.add_connection("/scan", kind, typestore=STORE1)
        for k in range(3):
            scan = types[kind](
                header=types["std_msgs/msg/Header"](
                    seq=k,
                    stamp=types["builtin_interfaces/msg/Time"](sec=1_600_000_000 + k, nanosec=5),
                    frame_id="/laser",
                ),
                angle_min=-1.0, angle_max=1.0, angle_increment=0.5, time_increment=0.0,
                scan_time=0.0, range_min=0.0, range_max=5.0,
                ranges=np.array([1, 2, 3, 4, 9], dtype=np.float32),
                intensities=np.zeros(0, dtype=np.float32),
            )  # fmt: skip
            writer.write(connection, 7 + k, STORE1.serialize_ros1(scan, kind))
    log = read_any(path)
    assert [m.stamp_ns for m in read(log)[1:]] == [
        (1_600_000_000 + k) * 1_000_000_000 + 5 for k in range(3)
    ]
    assert [receipt for _, receipt in log.received()] == [7, 7, 8, 9]
    assert not log.changed
    assert not log.warnings
    assert "no odometry: laser alone" in log.notes


def test_damaged_and_unusable_bags_are_one_clear_line(tmp_path: Path):
    write_bag(tmp_path / "bag", StoragePlugin.MCAP)
    whole = (tmp_path / "bag" / "bag.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    for length in range(20, len(whole), 61):
        cut.write_bytes(whole[:length])
        with pytest.raises(LogError, match=r"cut\.mcap"):
            read_any(cut)
    (tmp_path / "x.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(300))
    (tmp_path / "x.db3").write_bytes(b"SQLite format 3\0" + bytes(300))
    for name in ("x.bag", "x.db3"):
        with pytest.raises(LogError, match=name):
            read_any(tmp_path / name)
    write_ros2(tmp_path / "odom", [(None, WheelOdometry(START, 0.0, 0.0, 0.0))])
    with pytest.raises(LogError, match="holds no sensor_msgs/LaserScan"):
        read_any(tmp_path / "odom")


def test_flipped_bytes_lose_messages_or_the_bag_but_raise_nothing_else(tmp_path: Path):
    write_bag(tmp_path / "bag", StoragePlugin.MCAP)
    whole = (tmp_path / "bag" / "bag.mcap").read_bytes()
    rng = np.random.default_rng(5)
    bad = tmp_path / "bad.mcap"
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[int(rng.integers(40, len(whole)))] ^= int(rng.integers(1, 256))
        bad.write_bytes(damaged)
        with suppress(LogError):
            read_any(bad)


def test_an_export_never_replaces_anything_and_leaves_no_half(tmp_path: Path):
    with pytest.raises(LogError, match="no message"):
        write_ros2(tmp_path / "bag", [])
    with pytest.raises(LogError, match="already"):
        write_ros2(tmp_path, [])
    with pytest.raises(LogError, match="does not exist"):
        write_ros2(tmp_path / "no" / "bag", [])
    late = WheelOdometry(2**32 * 10**9, 0.0, 0.0, 0.0)
    with pytest.raises(LogError, match="no message"):
        write_ros2(tmp_path / "bag", [(None, late)])
    assert list(tmp_path.iterdir()) == []


def test_a_bag_is_imported_without_holding_it_in_memory(tmp_path: Path):
    rng = np.random.default_rng(2)
    beams, n = 1081, 2000
    scans = (
        LaserScan(START + k * STEP, -2.0, 0.004, rng.random(beams).astype(np.float32) + 1)
        for k in range(n)
    )
    write_ros2(tmp_path / "bag", ((scan.stamp_ns, scan) for scan in scans))
    tracemalloc.start()
    log = read_any(tmp_path / "bag")
    assert isinstance(log, StreamedLog)
    assert sum(1 for _ in log.received()) == n + 1
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.5 * n * beams * 4
