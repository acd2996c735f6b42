"""Whatever is simulated comes back the same from any form of recording that holds it."""

from __future__ import annotations

import math
import tempfile
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.exporters.carmen import write_carmen
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from tests.logs import bags, rawlogs
from tests.logs.bags import ODOMETRY, SCAN, TF, Item, Maker

names = st.sampled_from(("scan", "base_scan", "laser", "lidar/front", "hokuyo_node/scan_raw"))
wheels = st.sampled_from(("odom", "odometry", "wheel/odometry", "rosaria/pose", "base/odom_raw"))
prefixes = st.sampled_from(("", "robot1", "tb3_0", "a/b"))
bases = st.sampled_from(("base_link", "base_footprint", "base", "chassis", "p3dx"))
lasers = st.sampled_from(("laser", "base_scan", "laser_frame", "lms"))
places = st.floats(-0.5, 0.5).map(lambda v: round(v, 3))
mounts = st.tuples(places, places, st.floats(-3.1, 3.1))


@pytest.fixture(scope="module")
def drives():
    """The first seconds of some simulated drives, by name of the world."""
    known: dict[str, list] = {}

    def of(name: str) -> list:
        if name not in known:
            known[name] = list(islice(simulate(scenario(name)), 40))
        return known[name]

    return of


class Names:
    """How one recording calls things."""

    def __init__(self, draw) -> None:
        prefix = draw(prefixes)
        frame = f"{prefix}/" if prefix and draw(st.booleans()) else ""
        slash = "/" if draw(st.booleans()) else ""  # as ROS 1 programs wrote frames
        self.scan = "/" + "/".join(filter(None, (prefix, draw(names))))
        self.odometry = "/" + "/".join(filter(None, (prefix, draw(wheels))))
        self.base, self.laser = f"{slash}{frame}{draw(bases)}", f"{slash}{frame}{draw(lasers)}"
        if self.laser.strip("/") == self.base.strip("/"):
            self.laser += "_1"
        self.odom = f"{slash}{frame}odom"
        self.plate = f"{slash}{frame}plate"


def items_of(draw, messages: list, names: Names, make: Maker, mount) -> list[Item]:
    """The messages as a robot's recorder may have them, transforms in one of several ways."""
    items: list[Item] = []
    start = messages[0].stamp_ns
    chain = draw(st.sampled_from(("one", "two", "reversed", "on tf")))
    by_tf = draw(st.booleans())
    topic = "/tf" if chain == "on tf" else "/tf_static"
    if chain == "two":
        x, y, theta = draw(mounts)
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = mount[0] - x, mount[1] - y
        rest = (c * dx + s * dy, c * dy - s * dx, mount[2] - theta)
        items.append((topic, TF, start, make.tf(start, names.plate, names.laser, *rest)))
        items.append((topic, TF, start, make.tf(start, names.base, names.plate, x, y, theta)))
    elif chain == "reversed":
        c, s = math.cos(mount[2]), math.sin(mount[2])
        back = (-c * mount[0] - s * mount[1], s * mount[0] - c * mount[1], -mount[2])
        items.append((topic, TF, start, make.tf(start, names.laser, names.base, *back)))
    else:
        items.append((topic, TF, start, make.tf(start, names.base, names.laser, *mount)))
    for message in messages:
        stamp = message.stamp_ns
        receipt = stamp + draw(st.integers(0, 30_000_000))
        if isinstance(message, WheelOdometry):
            pose = (message.x, message.y, message.theta)
            if by_tf:
                sent = make.tf(stamp, names.odom, names.base, *pose)
                items.append(("/tf", TF, receipt, sent))
            else:
                sent = make.odometry(stamp, *pose, frame=names.odom, child=names.base)
                items.append((names.odometry, ODOMETRY, receipt, sent))
        elif isinstance(message, LaserScan):
            sent = make.scan(
                stamp, message.ranges, names.laser, angle_min=message.angle_min,
                angle_increment=message.angle_step, range_min=message.range_min,
                range_max=message.range_max, time_increment=message.beam_period_s,
            )  # fmt: skip
            items.append((names.scan, SCAN, receipt, sent))
    if draw(st.booleans()):
        items.sort(key=lambda item: item[2])
    return items


def write(draw, folder: Path, items: list[Item], ros1: bool) -> Path:
    """Write a recording in one of the containers, with options of the recorder."""
    kind = draw(st.sampled_from(("bag", "mcap") if ros1 else ("mcap", "mcap bag", "sqlite")))
    if kind == "bag":
        return bags.write_bag1(folder / "a.bag", items, draw(st.sampled_from(("", "BZ2", "LZ4"))))
    if kind == "mcap":
        return bags.write_mcap(
            folder / "a.mcap", items, ros1=ros1,
            profile=draw(st.sampled_from(("", "ros1" if ros1 else "ros2"))),
            chunk_size=draw(st.sampled_from((1000, 100_000))),
            use_chunking=draw(st.booleans()), use_statistics=draw(st.booleans()),
            compression=draw(st.sampled_from(list(bags.CompressionType))),
        )  # fmt: skip
    return bags.write_bag2(folder / "bag", items, kind == "sqlite", draw(st.sampled_from((8, 9))))


def expected(messages: list) -> list:
    kept = [m for m in messages if isinstance(m, LaserScan | WheelOdometry)]
    return sorted(kept, key=lambda m: (m.stamp_ns, isinstance(m, LaserScan)))


def check_same(got: list, wanted: list, digits: float) -> None:
    """Messages are the same but for rounding to what the form holds."""
    assert [(type(m), m.stamp_ns) for m in got] == [(type(m), m.stamp_ns) for m in wanted]
    for a, b in zip(got, wanted, strict=True):
        if isinstance(a, WheelOdometry):
            assert (a.x, a.y) == (b.x, b.y)
            assert abs(math.remainder(a.theta - b.theta, math.tau)) < 1e-12
        else:
            assert a.ranges.tobytes() == b.ranges.tobytes()
            assert a.angle_min == pytest.approx(b.angle_min, abs=digits)
            assert a.angle_step == pytest.approx(b.angle_step, rel=1e-6)


def near(mount: LaserExtrinsics, wanted) -> bool:
    turned = math.remainder(mount.theta - wanted[2], math.tau)
    return max(abs(mount.x - wanted[0]), abs(mount.y - wanted[1]), abs(turned)) < 1e-9


WORLDS = st.sampled_from(("testbed-180cm", "testbed", "corridor"))
FEW = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
MANY = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def from_ros(drives, draw) -> None:
    messages, mount = drives(draw(WORLDS)), draw(mounts)
    ros1 = draw(st.booleans())
    names_ = Names(draw)
    items = items_of(draw, messages, names_, Maker(ros1), mount)
    with tempfile.TemporaryDirectory() as folder:
        path = write(draw, Path(folder), items, ros1)
        log = read_any(path, Wishes(base=names_.base if "p3dx" in names_.base else ""))
        place, *got = [message for message, _ in log.received()]
    assert log.skipped == {}
    assert log.warnings == []
    check_same(got, expected(messages), 1e-6)
    assert isinstance(place, LaserExtrinsics)
    assert near(place, mount)


def from_carmen(drives, draw) -> None:
    messages, mount = drives(draw(WORLDS)), draw(mounts)
    sent = [LaserExtrinsics(messages[0].stamp_ns, *mount)]
    sent += [m for m in messages if not isinstance(m, LaserExtrinsics | TruePose)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.clf"
        write_carmen(path, sent)
        if form := draw(st.sampled_from(("", "raw"))):
            text = path.read_text().splitlines()
            path.write_text("\n".join(map(without_poses, text)) + "\n")
        log = read_any(path)
    place, *got = log.messages
    scans = [m for m in got if isinstance(m, LaserScan)]
    wanted = [m for m in expected(messages) if isinstance(m, LaserScan)]
    assert [m.stamp_ns for m in scans] == [m.stamp_ns for m in wanted]
    for a, b in zip(scans, wanted, strict=True):
        np.testing.assert_array_equal(a.ranges, np.where(b.ranges >= a.range_max, np.inf, b.ranges))
    assert near(place, mount)
    if form:
        back = [m for m in got if isinstance(m, WheelOdometry)]
        check_same(back, [m for m in expected(messages) if isinstance(m, WheelOdometry)], 0.0)


def from_rawlog(drives, draw) -> None:
    messages, mount = drives(draw(WORLDS)), draw(mounts)
    version, prefix = draw(st.integers(4, 8)), draw(st.sampled_from(("", "mrpt::obs::")))
    label = draw(st.sampled_from(("LASER1", "FRONT", ""))) if version >= 5 else ""
    steps = draw(st.booleans())  # odometry as steps from frame to frame
    made, wanted, last = [], expected(messages), (0.0, 0.0, 0.0)
    if steps:
        scans = {m.stamp_ns for m in wanted if isinstance(m, LaserScan)}
        wanted = [m for m in wanted if m.stamp_ns in scans]
    for message in wanted:
        if isinstance(message, LaserScan):
            made.append(rawlogs.scan(message, mount, version, label, prefix))
        elif steps:
            here = (message.x, message.y, message.theta)
            made.append(rawlogs.moved(step_between(last, here)))
            last = here
        else:
            made.append(rawlogs.wheels(message, draw(st.integers(0, 2)), prefix))
        if draw(st.integers(0, 9)) == 0:
            made.append(rawlogs.thing("CObservationImage", 4, bytes(range(256))))
    with tempfile.TemporaryDirectory() as folder:
        log = read_any(rawlogs.write(Path(folder) / "a.rawlog", made, draw(st.booleans())))
    place, *got = log.messages
    assert log.skipped == {}
    assert log.warnings == []
    assert near(place, mount)
    assert [(type(m), m.stamp_ns) for m in got] == [(type(m), m.stamp_ns) for m in wanted]
    for a, b in zip(got, wanted, strict=True):
        if isinstance(a, WheelOdometry):
            assert (a.x, a.y) == pytest.approx((b.x, b.y), abs=1e-9)
            assert abs(math.remainder(a.theta - b.theta, math.tau)) < 1e-9
        else:
            np.testing.assert_array_equal(
                a.ranges, np.where(np.isfinite(b.ranges), b.ranges, np.inf)
            )
            assert a.angle_min == pytest.approx(b.angle_min, abs=1e-6)
            assert a.angle_step == pytest.approx(b.angle_step, rel=1e-6)


def step_between(start, end):
    c, s = math.cos(start[2]), math.sin(start[2])
    dx, dy = end[0] - start[0], end[1] - start[1]
    return c * dx + s * dy, c * dy - s * dx, end[2] - start[2]


def without_poses(line: str) -> str:
    """A laser line as the RAWLASER1 that a logger without localisation writes."""
    fields = line.split()
    if fields[0] == "ROBOTLASER1":
        return " ".join(["RAWLASER1", *fields[1:-14], *fields[-3:]])
    if fields[0] == "FLASER":
        n = int(fields[1])
        step = math.pi / (n - n % 2)
        geometry = [0, -math.pi / 2, step * (n - 1), step, 0, 0.01, 0, n]
        return " ".join(["RAWLASER1", *map(repr, geometry), *fields[2 : 2 + n], "0", *fields[-3:]])
    return line


@FEW
@given(data=st.data())
def test_a_simulated_drive_comes_back_from_any_ros_recording(drives, data):
    from_ros(drives, data.draw)


@FEW
@given(data=st.data())
def test_a_simulated_drive_comes_back_from_carmen(drives, data):
    from_carmen(drives, data.draw)


@FEW
@given(data=st.data())
def test_a_simulated_drive_comes_back_from_a_rawlog(drives, data):
    from_rawlog(drives, data.draw)


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_simulated_drives_come_back_from_hundreds_of_rawlogs(drives, data):
    from_rawlog(drives, data.draw)


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_simulated_drives_come_back_from_hundreds_of_ros_recordings(drives, data):
    from_ros(drives, data.draw)


@pytest.mark.slow
@MANY
@given(data=st.data())
def test_simulated_drives_come_back_from_hundreds_of_carmen_logs(drives, data):
    from_carmen(drives, data.draw)
