"""Recordings as people report them in public trackers, and what has to come of each."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from slam.logs.errors import LogError
from slam.logs.importers.bag import files
from slam.logs.importers.detect import read_any
from slam.logs.importers.imported import StreamedLog
from slam.logs.importers.wishes import Wishes, mount_in_words, parse_mount
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry
from slam.logs.recover import recover

from tests.logs import bags
from tests.logs.bags import ECHOES, ODOMETRY, ROS2, SCAN, START, STEP, TF, drive, room

S = 10**9


class Read:
    """A recording as it was imported."""

    def __init__(self, path: Path, **wishes):
        self.log = read_any(path, Wishes(**wishes))
        messages = [message for message, _ in self.log.received()]
        assert isinstance(self.log, StreamedLog)
        self.mount = messages[0]
        assert isinstance(self.mount, LaserExtrinsics)
        self.scans = [m for m in messages if isinstance(m, LaserScan)]
        self.odometry = [m for m in messages if isinstance(m, WheelOdometry)]
        self.x = [m.x for m in self.odometry]
        stamps = [m.stamp_ns for m in messages[1:]]
        assert stamps == sorted(stamps)

    @property
    def sound(self) -> bool:
        return not (self.log.skipped or self.log.warnings)

    def is_drive(self, n: int = 20, mount=(0.2, 0.0, 0.3)) -> bool:
        """Whether n scans and n odometry messages came, with nothing skipped or guessed."""
        place = (self.mount.x, self.mount.y, self.mount.theta)
        assert self.log.skipped == {}
        assert self.log.warnings == []
        assert (len(self.scans), len(self.odometry)) == (n, n)
        assert place == pytest.approx(mount)
        assert self.x == pytest.approx([0.1 * k for k in range(n)])
        return True


@pytest.fixture
def read(tmp_path: Path):
    def made(items, **wishes):
        read.count += 1
        return Read(bags.write_bag2(tmp_path / f"bag{read.count}", items), **wishes)

    read = made
    made.count = 0
    return made


def test_r02_what_recover_saves_of_a_crashed_bag_can_be_imported(tmp_path: Path):
    whole = bags.write_mcap(tmp_path / "big.mcap", drive(400), chunk_size=20_000)
    data = whole.read_bytes()
    crashed = tmp_path / "crashed.mcap"
    crashed.write_bytes(data[: int(0.6 * len(data))])
    with pytest.raises(LogError, match=r"slam recover .*crashed\.mcap --out"):
        read_any(crashed)
    saved = tmp_path / "saved.mcap"
    report = recover(crashed, saved)
    assert report.lost
    assert 300 < sum(report.messages.values()) < 800
    first, again = Read(whole), Read(saved)
    assert len(again.scans) == report.messages["/scan"]
    for a, b in zip(again.scans, first.scans, strict=False):
        assert (a.stamp_ns, a.ranges.tobytes()) == (b.stamp_ns, b.ranges.tobytes())
    assert again.odometry == first.odometry[: len(again.odometry)]
    assert saved.read_bytes()[17:25] == b"\x04\0\0\0ros2"  # the profile
    assert b"a test" in saved.read_bytes()[:60]  # the library
    assert Read(bags.write_mcap(tmp_path / "m.mcap", drive(), profile="")).is_drive()


@pytest.mark.parametrize("middle", [False, True])
def test_r03_odometry_in_tf_alone(read, middle):
    items = [("/tf_static", TF, START, ROS2.tf(START, "base_link", "laser", 0.2))]
    if middle:
        items.append(("/tf_static", TF, START, ROS2.tf(START, "base_footprint", "base_link", 0.0)))
    child = "base_footprint" if middle else "base_link"
    for k in range(20):
        t = START + k * STEP
        items += [
            ("/tf", TF, t, ROS2.tf(t, "map", "odom", 5.0 * math.sin(k), 0.3, 0.1 * k)),
            ("/tf", TF, t, ROS2.tf(t, "odom", child, 0.1 * k)),
            ("/scan", SCAN, t + 1, ROS2.scan(t, room())),
        ]
    got = read(items)
    assert got.is_drive(mount=(0.2, 0.0, 0.0))
    assert f"odometry from /tf odom -> {child}" in got.log.notes


def test_a_localisers_transform_is_no_odometry(read):
    items = [("/tf_static", TF, START, ROS2.tf(START, "base_link", "laser", 0.2))]
    for k in range(20):
        t = START + k * STEP
        items += [
            ("/tf", TF, t, ROS2.tf(t, "map", "base_link", 0.1 * k)),
            ("/scan", SCAN, t + 1, ROS2.scan(t, room())),
        ]
    got = read(items)
    assert got.odometry == []
    assert len(got.scans) == 20
    assert "no odometry: laser alone" in got.log.notes
    asked = read(items, odometry="map>base_link")
    assert asked.x == pytest.approx([0.1 * k for k in range(20)])


def test_r04_frames_with_a_prefix_and_bases_of_other_names(read):
    robot = drive(
        scan="/robot1/scan", odom="/robot1/odom", tf="/robot1/tf_static", laser="robot1/laser",
        child="robot1/base_link", frame="robot1/odom", mount=(0.2, 0.1, 1.0),
    )  # fmt: skip
    got = read(robot)
    assert got.is_drive(mount=(0.2, 0.1, 1.0))
    assert ", ".join(got.log.notes) == (
        "scans from /robot1/scan, odometry from /robot1/odom, "
        "laser at (0.20, 0.10, 57.3 deg) on robot1/base_link, from /tf_static"
    )
    assert read(drive(child="chassis", mount=(0.2, 0.0, 0.0))).is_drive(mount=(0.2, 0.0, 0.0))
    lost = read(drive(child="hull", tf="/tf_static", mount=None))
    (warning,) = lost.log.warnings
    assert "no transform from hull to laser" in warning
    assert "--mount x,y,theta" in warning


def test_a_base_that_nothing_names_is_a_guess_with_alternatives(read):
    chain = [
        ("/tf_static", TF, START, ROS2.tf(START, "hull", "plate", 0.1)),
        ("/tf_static", TF, START, ROS2.tf(START, "plate", "laser", 0.1)),
    ]
    got = read(chain + drive(child="", mount=None))
    assert got.mount.x == pytest.approx(0.2)
    (warning,) = got.log.warnings
    assert "hull is taken" in warning
    assert "--base takes another (plate)" in warning
    asked = read(chain + drive(child="", mount=None), base="plate")
    assert asked.mount.x == pytest.approx(0.1)
    assert asked.sound
    with pytest.raises(LogError, match="no frame nose for --base: there are hull, laser, plate"):
        read(drive(child="hull", mount=None) + chain, base="nose")


def test_r06_a_bag_without_transforms_is_told_where_the_laser_sits(read):
    bare = read(drive(mount=None))
    (warning,) = bare.log.warnings
    assert "--mount x,y,theta" in warning
    assert "bends every turn" in warning
    got = read(drive(mount=None), mount=(0.16, 0.0, 3.14159))
    assert got.is_drive(mount=(0.16, 0.0, 3.14159))
    assert any("180.0 deg" in note and "--mount" in note for note in got.log.notes)
    assert read(drive(), mount=(0.5, 0.0, 0.0)).is_drive(mount=(0.5, 0.0, 0.0))


def test_r06_the_second_part_of_a_split_bag_names_its_folder(tmp_path: Path):
    folder = tmp_path / "split"
    folder.mkdir()
    items = drive(40)
    bags.write_mcap(folder / "split_0.mcap", items[:41])
    bags.write_mcap(folder / "split_1.mcap", items[41:])
    assert Read(folder).is_drive(40)
    second = Read(folder / "split_1.mcap")
    assert len(second.scans) == 20
    assert any("name its folder" in warning for warning in second.log.warnings)
    (folder / "metadata.yaml").write_text(
        "  relative_file_paths:\n    - split_0.mcap\n    - split_1.mcap\n    - split_2.mcap\n"
    )
    part = Read(folder)
    assert len(part.scans) == 40
    assert part.log.skipped == {"part split_2.mcap that metadata.yaml names is not there": 1}


def test_parts_are_read_in_the_order_of_their_numbers(tmp_path: Path):
    folder = tmp_path / "many"
    folder.mkdir()
    items = drive(24)
    for k in range(12):
        bags.write_mcap(folder / f"m_{k}.mcap", items[4 * k + (k > 0) : 4 * k + 5])
    assert Read(folder).is_drive(24)


def truth(topic: str, n: int, period_ns: int, frame: str = "odom") -> list[bags.Item]:
    return [
        (topic, ODOMETRY, t := START + k * period_ns, ROS2.odometry(t, 50.0 + k, frame=frame))
        for k in range(n)
    ]


def test_r07_the_ground_truth_is_never_taken_for_odometry(read):
    stage = drive(scan="/robot_0/base_scan", odom="/robot_0/odom")
    got = read(truth("/robot_0/base_pose_ground_truth", 20, STEP) + stage)
    assert got.is_drive()
    assert "odometry from /robot_0/odom" in got.log.notes
    gazebo = read(truth("/ground_truth", 100, STEP // 5) + drive(odom="/wheel/odometry"))
    assert gazebo.is_drive()
    alone = read(truth("/ground_truth", 100, STEP // 5) + drive(odom=""))
    assert alone.odometry == []
    assert "--odom takes it" in alone.log.warnings[0]
    asked = read(truth("/ground_truth", 20, STEP) + drive(odom=""), odometry="/ground_truth")
    assert asked.x[0] == 50.0
    assert asked.sound
    in_map = read(truth("/state", 100, STEP // 5, frame="map") + drive(odom="/wheel"))
    assert in_map.x[:2] == pytest.approx([0.0, 0.1])


def test_odometry_of_a_camera_or_of_equal_rank_is_a_guess_with_alternatives(read):
    seen = read(truth("/zed/odom", 60, STEP // 3) + drive(odom="/base/odom"))
    assert seen.is_drive()
    assert "odometry from /base/odom" in seen.log.notes
    (warning,) = read(truth("/arm/odom", 20, STEP) + drive(odom="/base/odom")).log.warnings
    assert "--odom takes another" in warning


def test_odometry_of_which_nothing_can_be_used_is_told(read):
    items = drive()
    for topic, _, _, message in items:
        if topic == "/odom":
            message.pose.pose.orientation.w = math.nan
    got = read(items)
    assert got.odometry == []
    (warning,) = got.log.warnings
    assert "no message of /odom can be used as odometry" in warning


def test_r07_another_robots_odometry_is_never_taken(read):
    robots = []
    for number, x in ((1, 0.0), (2, 50.0)):
        name = f"robot{number}"
        robots += drive(
            scan=f"/{name}/scan", odom=f"/{name}/odom", laser=f"{name}/laser", start_x=x,
            child=f"{name}/base_link", frame=f"{name}/odom",
        )  # fmt: skip
    short = [i for i in robots if i[0] != "/robot1/odom" or i[2] >= START + 3 * STEP]
    got = read(short)
    assert got.x == pytest.approx([0.1 * k for k in range(3, 20)])
    assert "--scan takes another (/robot2/scan)" in got.log.warnings[0]
    assert read(robots, scan="/robot2/scan").x[0] == 50.0
    only_theirs = [i for i in robots if i[0] not in ("/robot1/odom", "/robot2/scan")]
    assert read(only_theirs).odometry == []


def test_r08_drives_that_follow_each_other_are_never_shuffled(read):
    items = drive(20)
    for k in range(20):
        receipt = START + (30 + k) * STEP
        stamp = START + k * STEP
        items += [
            ("/odom", ODOMETRY, receipt, ROS2.odometry(stamp, -0.1 * k)),
            ("/scan", SCAN, receipt + 1, ROS2.scan(stamp, room())),
        ]
    with pytest.raises(LogError, match=r"holds 2 drives: time steps back by 1\.9 s after 20 scans"):
        read(items)
    assert read(items, drive=1).x == pytest.approx([0.1 * k for k in range(20)])
    second = read(items, drive=2)
    assert second.x == pytest.approx([-0.1 * k for k in range(20)])
    assert second.log.changed["messages of other drives than drive 2, left out"] == 40
    with pytest.raises(LogError, match="has no drive 3"):
        read(items, drive=3)
    by_receipt = read(items, receipt_time=True)
    assert len(by_receipt.scans) == 40


def test_small_disorder_is_sorted_and_a_stray_stamp_is_no_drive(read):
    items = drive(20)
    items[9], items[19] = items[19], items[9]
    assert read(items).is_drive()
    stray = drive(40)
    for k, ahead in ((21, 3600 * S), (44, -5 * S)):
        message = stray[k][3]
        stamp = START + (k - 1) // 2 * STEP + ahead
        message.header.stamp = ROS2.header(stamp, "").stamp
    got = read(stray)
    assert len(got.scans) + len(got.odometry) == 79
    assert sum(got.log.skipped.values()) == 1


@pytest.mark.parametrize("options", [
    {"use_chunking": False}, {"use_chunking": False, "index_types": 0},
    {"compression": bags.CompressionType.LZ4}, {"compression": bags.CompressionType.NONE},
    {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False},
])  # fmt: skip
def test_r10_an_mcap_file_of_any_layout(tmp_path: Path, options):
    from mcap.writer import IndexType

    items = drive()
    items[20], items[21] = items[21], items[20]
    if "index_types" in options:
        options = options | {"index_types": IndexType.NONE}
    assert Read(bags.write_mcap(tmp_path / "fastwrite.mcap", items, **options)).is_drive()
    bags.write_mcap(tmp_path / "noname", items, **options)
    assert Read(tmp_path / "noname").is_drive()


@pytest.mark.parametrize("foreign", [
    ("/json", "jsonschema", b'{"type": "object"}'), ("/pb", "protobuf", b"\x0a\xff\xfe\x80"),
    ("/none", "", b""), ("/odd", "flatbuffer", b"\x00\xff"),
])  # fmt: skip
def test_r12_foreign_channels_do_no_harm(tmp_path: Path, foreign):
    got = Read(bags.write_mcap(tmp_path / "x.mcap", drive(), foreign=[foreign]))
    assert got.is_drive()
    assert any(name.startswith(foreign[0]) for name in got.log.ignored)


def test_r14_receipt_stands_in_for_stamps_that_are_zero(read):
    items = drive()
    for topic, _, _, message in items:
        if topic == "/scan":
            message.header = ROS2.header(0, "laser")
    got = read(items)
    assert [s.stamp_ns for s in got.scans] == [START + k * STEP + 2000 for k in range(20)]
    assert got.log.warnings == ["/scan: 20 x stamp zero, time of receipt taken"]
    first = drive()
    first[2][3].header = ROS2.header(0, "laser")
    got = read(first)
    assert [s.stamp_ns for s in got.scans][:2] == [START + 2000, START + STEP]
    assert got.log.warnings == ["/scan: 1 x stamp zero, time of receipt taken"]


@pytest.mark.parametrize("ahead_s", [3600, -3600, 402, -2.5])
def test_r15_clocks_far_apart_are_refused_with_the_difference(read, ahead_s):
    items = drive()
    for k, (topic, _, _, message) in enumerate(items):
        if topic == "/odom":
            stamp = START + (k - 1) // 2 * STEP + int(ahead_s * S)
            message.header = ROS2.header(stamp, "odom")
    named = rf"clocks of /scan and /odom differ by {abs(ahead_s):g} s.*--use-receipt-time"
    with pytest.raises(LogError, match=named):
        read(items)
    got = read(items, receipt_time=True)
    assert got.is_drive()
    assert [s.stamp_ns for s in got.scans] == [START + k * STEP + 2000 for k in range(20)]


def test_clocks_a_little_apart_are_told(read):
    got = read(drive(odom_delay_ns=int(0.4 * S)))
    assert len(got.scans) == len(got.odometry) == 20
    (warning,) = got.log.warnings
    assert "differ by 0.4 s" in warning
    assert read(drive(odom_delay_ns=int(0.15 * S))).is_drive()


@pytest.mark.parametrize("factor", [1.0, 0.5, 3.0])
def test_simulated_time_beside_receipts_of_today_is_no_fault(read, factor):
    items = []
    for topic, kind, receipt, message in drive(60):
        stamp = receipt - START - receipt % 10_000
        if topic != "/tf_static":
            message.header.stamp = ROS2.header(S + stamp - 1000 * (stamp % 1000 > 0), "").stamp
        items.append((topic, kind, START + int((receipt - START) / factor), message))
    assert read(items).is_drive(60)


def test_the_first_stamp_of_a_simulation_may_be_zero(read):
    items = []
    for topic, kind, receipt, message in drive(20):
        if topic != "/tf_static":
            message.header.stamp = ROS2.header((receipt - START) // STEP * STEP, "").stamp
        items.append((topic, kind, receipt, message))
    got = read(items)
    assert got.is_drive()
    assert got.scans[0].stamp_ns == 0


def maker1() -> bags.Maker:
    return bags.Maker(ros1=True)


@pytest.mark.parametrize("compression", ["", "BZ2", "LZ4"])
def test_r20_a_ros_1_bag_that_was_not_closed(tmp_path: Path, compression):
    whole = bags.write_bag1(tmp_path / "x.bag", drive(30, make=maker1()), compression)
    data = whole.read_bytes()
    active = tmp_path / "x.bag.active"
    active.write_bytes(data)
    assert Read(active).is_drive(30)
    plain = tmp_path / "without suffix"
    plain.write_bytes(data)
    assert Read(plain).is_drive(30)
    at = data.index(b"index_pos=") + len(b"index_pos=")
    unindexed = tmp_path / "unindexed.bag"
    unindexed.write_bytes(data[:at] + bytes(8) + data[at + 8 :])
    got = Read(unindexed)
    assert (len(got.scans), len(got.odometry)) == (30, 30)
    assert got.log.skipped == {"end of the bag: it was not closed": 1}
    with pytest.raises(LogError) as caught:
        recover(unindexed, tmp_path / "r.mcap")
    assert "ROS bag" in str(caught.value)
    assert "slam import" in str(caught.value)


def test_a_ros_1_bag_that_is_cut_off_gives_what_is_there(tmp_path: Path):
    data = bags.write_bag1(tmp_path / "x.bag", drive(30, make=maker1())).read_bytes()
    cut = tmp_path / "cut.bag"
    counts = []
    for share in (0.2, 0.4, 0.6, 0.8):
        cut.write_bytes(data[: int(share * len(data))])
        got = Read(cut)
        counts.append(len(got.scans))
        assert got.log.skipped
    assert counts == sorted(counts)
    assert counts[0] > 0
    assert counts[-1] > 20


def test_damage_in_the_middle_of_a_ros_1_bag_costs_what_it_hit(tmp_path: Path):
    data = bytearray(bags.write_bag1(tmp_path / "x.bag", drive(30, make=maker1())).read_bytes())
    half = len(data) // 2
    data[half : half + 700] = bytes(700)
    (tmp_path / "x.bag").write_bytes(data)
    got = Read(tmp_path / "x.bag")
    assert 54 <= len(got.scans) + len(got.odometry) < 60
    assert got.log.skipped


@pytest.mark.parametrize("x", [1e256, 1e300, 1e12, math.inf, math.nan])
@pytest.mark.parametrize("at", [0, 9, 19])
def test_r22_odometry_where_no_robot_can_be_is_skipped(read, x, at):
    items = drive()
    items[1 + 2 * at][3].pose.pose.position.x = x
    got = read(items)
    assert got.x == pytest.approx([0.1 * k for k in range(20) if k != at])
    assert sum(got.log.skipped.values()) == 1
    assert len(got.scans) == 20


def test_a_single_spike_of_odometry_is_skipped(read):
    items = drive()
    items[21][3].pose.pose.position.y = 1e5
    assert len(read(items).odometry) == 19


def test_odometry_without_a_rotation_is_skipped(read):
    items = drive()
    zero = bags.STORE.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=0.0)
    items[11][3].pose.pose.orientation = zero
    got = read(items)
    assert got.log.skipped == {"odometry without a heading (its quaternion is zero)": 1}
    assert len(got.odometry) == 19


def test_odometry_that_is_set_back_to_zero_goes_on(read):
    items = drive(20, start_x=2.0)
    for k in range(20):
        t = START + (20 + k) * STEP
        items += [
            ("/odom", ODOMETRY, t + 1, ROS2.odometry(t, 0.1 * k)),
            ("/scan", SCAN, t + 2, ROS2.scan(t, room())),
        ]
    got = read(items)
    steps = np.diff(got.x)
    assert steps == pytest.approx([0.1] * 19 + [0.0] + [0.1] * 19)
    assert got.log.changed == {"odometry set back to zero, carried on from where it was": 1}


def test_r24_a_type_without_a_definition_is_read_by_the_standard_one(tmp_path: Path):
    for n, form in enumerate([("", b""), ("ros2msg", b""), ("ros2msg", b"float32 nonsense[[")]):
        path = bags.write_mcap(tmp_path / f"{n}.mcap", drive(), schemas={"/scan": form})
        assert Read(path).is_drive()
    every = dict.fromkeys(("/scan", "/odom", "/tf_static"), ("", b""))
    assert Read(bags.write_mcap(tmp_path / "none.mcap", drive(), schemas=every)).is_drive()


def test_r25_multi_echo_scans_give_their_first_echo(read):
    beams = [[], [2.0], [3.0, 4.0], [0.01, 5.0]] * 10
    echoes = [("/echoes", ECHOES, t := START + k * STEP, ROS2.echoes(t, beams)) for k in range(10)]
    got = read(echoes)
    assert len(got.scans) == 10
    assert "multi-echo: first echo taken" in got.log.notes
    assert got.scans[0].ranges[:3].tolist() == [math.inf, 2.0, 3.0]
    assert math.isnan(got.scans[0].ranges[3])


def test_a_recording_without_scans_says_what_it_holds(read):
    with pytest.raises(LogError, match=r"no sensor_msgs/LaserScan, only .*/odom \(nav_msgs"):
        read([i for i in drive() if i[0] != "/scan"])


def test_ros_1_messages_in_mcap(tmp_path: Path):
    path = bags.write_mcap(tmp_path / "a.mcap", drive(make=maker1()), ros1=True, profile="ros1")
    assert Read(path).is_drive()


def test_a_laser_described_with_the_wrong_sign_is_turned(read):
    items = drive()
    for topic, _, _, message in items:
        if topic == "/scan":
            message.angle_min, message.angle_max = 1.5, -1.5
            message.angle_increment = 3.0 / 179
    got = read(items)
    assert got.scans[0].angle_step == pytest.approx(-3.0 / 179)
    assert "20 scans end at angle_max only if their increment is turned" in got.log.warnings[0]
    for topic, _, _, message in items:
        if topic == "/scan":
            message.angle_increment = -3.0 / 179
    assert read(items).is_drive()


def test_two_places_of_one_frame_are_named_and_the_last_counts(read):
    again = ("/tf_static", TF, START + 5, ROS2.tf(START, "base_link", "laser", 0.1, 0.0, 0.3))
    got = read([*drive(), again])
    assert got.mount.x == pytest.approx(0.1)
    (warning,) = got.log.warnings
    assert "(0.20, 0.00, 17.2 deg) and (0.10, 0.00, 17.2 deg)" in warning
    moved = ("/tf_static", TF, START + 5, ROS2.tf(START, "plate", "laser", 0.0))
    plate = ("/tf_static", TF, START + 5, ROS2.tf(START, "base_link", "plate", 0.4))
    got = read([*drive(), plate, moved])
    assert got.mount.x == pytest.approx(0.4)
    assert "base_link, plate" in got.log.warnings[0]


def turning_laser(yaws) -> list[bags.Item]:
    items = [i for i in drive() if i[0] != "/tf_static"]
    items += [
        ("/tf", TF, t := START + k * STEP, ROS2.tf(t, "base_link", "laser", 0.2, 0.0, yaw))
        for k, yaw in enumerate(yaws)
    ]
    return items


def test_a_laser_that_moves_on_the_robot_is_refused(read):
    with pytest.raises(LogError, match=r"laser moves on the robot: base_link -> laser .* --mount"):
        read(turning_laser(np.linspace(0.0, 1.0, 20)))
    with pytest.raises(LogError, match=r"sent as .*0\.0 deg\) and .*28\.6 deg\) by turns"):
        read(turning_laser([0.0, 0.5] * 10))
    assert read(turning_laser([0.3, 0.301] * 10)).is_drive(mount=(0.2, 0.0, 0.301))
    assert read(turning_laser(range(6)), mount=(0.2, 0.0, 0.3)).is_drive()


def test_base_and_laser_under_one_moving_frame(read):
    items = [i for i in drive(child="base_footprint") if i[0] != "/tf_static"]
    items.append(("/tf_static", TF, START, ROS2.tf(START, "base_link", "laser", 0.2, 0.0, 0.3)))
    for k in range(20):
        t = START + k * STEP
        for child in ("base_link", "base_footprint"):
            items.append(("/tf", TF, t, ROS2.tf(t, "odom", child, 0.1 * k, 0.0, 0.2 * k)))
    assert read(items).is_drive()


def test_a_span_of_a_recording(read):
    got = read(drive(), start_s=0.45, end_s=1.0)
    assert [round(x, 3) for x in got.x] == [0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    with pytest.raises(LogError, match="holds no scan from 50 to 60 s"):
        read(drive(), start_s=50.0, end_s=60.0)


def test_a_mount_in_words_and_back():
    assert mount_in_words(0.2, 0.1, 1.0) == "(0.20, 0.10, 57.3 deg)"
    assert mount_in_words(-0.1016, -0.0, math.pi) == "(-0.102, 0.00, 180.0 deg)"
    assert parse_mount("0.2, 0.1, 57.3deg") == pytest.approx((0.2, 0.1, math.radians(57.3)))
    assert parse_mount("0.16,0,3.14159") == (0.16, 0.0, 3.14159)
    for bad in ("", "1,2", "a,b,c", "1,2,nan", "0.2,0,90"):
        with pytest.raises(ValueError, match=r"m, m and rad|finite|degrees"):
            parse_mount(bad)


def test_what_was_recorded_twice_is_taken_once(read):
    twice = [item for item in drive() for _ in range(2)]
    got = read(twice)
    assert got.is_drive()
    assert got.log.changed == {"scans recorded twice, one kept": 20}


def test_odometry_without_a_frame_and_no_transforms_is_a_guess(read):
    got = read(drive(child="", mount=None))
    (warning,) = got.log.warnings
    assert "no transform from the base to laser" in warning
    assert read(drive(child="laser", mount=None)).is_drive(mount=(0.0, 0.0, 0.0))
    assert read(drive(child="", mount=None), base="laser").sound


def test_a_base_whose_prefix_only_the_transforms_have_is_no_guess(read):
    place = ("/tf_static", TF, START, ROS2.tf(START, "r1/base_link", "r1/laser", 0.2, 0.0, 0.3))
    assert read([place, *drive(laser="r1/laser", mount=None)]).is_drive()


def test_a_transform_that_is_sent_again_and_again_counts_once(read):
    items = [("/tf_static", TF, START, ROS2.tf(START, "base_link", "laser", 0.2, 0.0, 0.3))]
    for k in range(20):
        t = START + k * STEP
        items += [("/tf", TF, t + n, ROS2.tf(t, "odom", "base_link", 0.1 * k)) for n in range(3)]
        items.append(("/scan", SCAN, t + 5, ROS2.scan(t, room())))
    assert read(items).is_drive()


@pytest.mark.parametrize("mode", ["FILE", "MESSAGE"])
def test_bags_compressed_as_a_whole_or_message_by_message(tmp_path: Path, mode: str):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    path = tmp_path / "bag"
    writer = Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        known = {}
        for topic, kind, receipt, message in drive():
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=bags.STORE)
            writer.write(known[topic], receipt, bags.STORE.serialize_cdr(message, kind))
    assert Read(path).is_drive()


def test_a_laser_that_turns_is_no_odometry(read):
    items = [i for i in turning_laser(np.linspace(0.0, 1.0, 20)) if i[0] != "/odom"]
    for k in range(20):
        t = START + k * STEP
        items.append(("/tf", TF, t, ROS2.tf(t, "odom", "base_link", 0.1 * k)))
    with pytest.raises(LogError, match="laser moves on the robot"):
        read(items)
    got = read(items, mount=(0.2, 0.0, 0.3))
    assert got.x == pytest.approx([0.1 * k for k in range(20)])


def test_nothing_is_named_at_all(read):
    (warning,) = read(drive(child="", laser="", mount=None)).log.warnings
    assert "no transform from the base to the laser" in warning


def test_a_definition_with_damaged_words_is_not_believed(tmp_path: Path):
    text = bags.STORE.generate_msgdef(SCAN, ros_version=2)[0]
    for old, new in (("Header header", "Header hxader"), ("float32[] ranges", "float64[] ranges")):
        assert old in text
        schemas = {"/scan": ("ros2msg", text.replace(old, new).encode())}
        assert Read(bags.write_mcap(tmp_path / "a.mcap", drive(), schemas=schemas)).is_drive()


def test_packed_parts_are_unpacked_up_to_a_limit(tmp_path: Path, monkeypatch):
    import zstandard

    packed = tmp_path / "bomb.mcap.zstd"
    whole = bags.write_mcap(tmp_path / "a.mcap", drive(400), compression=bags.CompressionType.NONE)
    packed.write_bytes(zstandard.ZstdCompressor().compress(whole.read_bytes()))
    assert Read(packed).is_drive(400)
    monkeypatch.setattr(files, "UNPACKED_LIMIT", 1 << 17)
    with pytest.raises(LogError, match=r"unpacks to more than 0 MB: unpack the parts with `zstd"):
        Read(packed)
    packed.write_bytes(zstandard.ZstdCompressor().compress(bytes(1 << 26)))  # 64 MB in 2 kB
    with pytest.raises(LogError, match="unpacks to more than"):
        Read(packed)
