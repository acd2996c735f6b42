"""`slam export` and `slam import`: logs and RUNs in the formats of other programs, and back."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import LaserScan, OccupancyMap, RawBytes, TruePose, WheelOdometry
from slam.logs.trajectory import read_tum

from slam.runs.config_file import load_config
from slam.runs.errors import RunError
from slam.runs.replay import replay
from slam.tools.exports import Targets, export
from slam.tools.imports import import_log

LATE_NS = 7_000_000  # from stamp to receipt


@pytest.fixture(scope="module")
def drive():
    return list(simulate(scenario("testbed-180cm")))


def write(path, messages):
    with LogWriter(path) as log:
        for message in messages:
            log.write(message, message.stamp_ns + LATE_NS)
    return path


@pytest.fixture(scope="module")
def log(drive, tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "drive.mcap", drive)


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    replay(log, out, load_config(None, ["loops.enabled=false"]))
    return out


def bag_messages(folder):
    with AnyReader([folder]) as bag:
        return [
            (connection.topic, receipt, bag.deserialize(data, connection.msgtype))
            for connection, receipt, data in bag.messages()
        ]


def test_a_log_becomes_a_bag_and_comes_back_with_its_times_of_receipt(log, drive, tmp_path):
    done = export(log, Targets(ros2=tmp_path / "bag"))
    assert not done.lost
    assert "74 /scan" in done.written[0]
    report = import_log(tmp_path / "bag", tmp_path / "back.mcap")
    assert report.scans == 74
    with open_log(log) as first, open_log(tmp_path / "back.mcap") as second:
        there = [(t, m) for t, m in first.receipts(("/scan",))]
        back = [(t, m) for t, m in second.receipts(("/scan",))]
    assert [t for t, _ in back] == [t for t, _ in there]
    assert all(t == m.stamp_ns + LATE_NS for t, m in back)
    for (_, a), (_, b) in zip(there, back, strict=True):
        np.testing.assert_array_equal(a.ranges, b.ranges)


def test_all_formats_at_once(log, drive, tmp_path):
    targets = Targets(
        carmen=tmp_path / "x.clf", csv=tmp_path / "tables", tum=tmp_path / "x.tum",
        ros2=tmp_path / "bag",
    )  # fmt: skip
    assert len(export(log, targets).written) == 4
    assert import_log(tmp_path / "x.clf", tmp_path / "x.mcap").scans == 74
    with (tmp_path / "tables" / "scan.csv").open() as file:
        rows = list(csv.DictReader(file))
    scans = [m for m in drive if isinstance(m, LaserScan)]
    assert [int(row["stamp_ns"]) for row in rows] == [m.stamp_ns for m in scans]
    assert int(rows[0]["receipt_ns"]) == scans[0].stamp_ns + LATE_NS


@pytest.mark.parametrize(("poses", "kind"), [("", WheelOdometry), ("truth", TruePose)])
def test_a_trajectory_of_a_log(log, drive, tmp_path, poses, kind):
    export(log, Targets(tum=tmp_path / "x.tum", poses=poses))
    found = read_tum(tmp_path / "x.tum")
    expected = [m for m in drive if isinstance(m, kind)]
    assert found.stamps_ns.tolist() == [m.stamp_ns for m in expected]
    np.testing.assert_allclose(
        found.poses, [(m.x, m.y, m.theta) for m in expected], rtol=0, atol=1e-12
    )


def test_a_pose_that_is_not_finite_is_left_out_and_counted(drive, tmp_path):
    broken = [
        replace(m, x=math.nan) if isinstance(m, WheelOdometry) and k < 30 else m
        for k, m in enumerate(drive)
    ]
    source = write(tmp_path / "nan.mcap", broken)
    done = export(source, Targets(tum=tmp_path / "x.tum"))
    assert sum(done.lost.values()) > 0
    assert np.isfinite(read_tum(tmp_path / "x.tum").poses).all()


def test_raw_bytes_are_no_loss_of_a_bag(drive, tmp_path):
    raw = RawBytes(drive[0].stamp_ns, "laser", "rx", b"\x00")
    done = export(write(tmp_path / "raw.mcap", [raw, *drive]), Targets(ros2=tmp_path / "bag"))
    assert not done.lost


def test_results_of_a_run_are_copied(run, tmp_path):
    export(run, Targets(tum=tmp_path / "a.tum", g2o=tmp_path / "a.g2o"))
    assert (tmp_path / "a.tum").read_bytes() == (run / "trajectory.tum").read_bytes()
    assert (tmp_path / "a.g2o").read_bytes() == (run / "graph.g2o").read_bytes()
    export(run, Targets(tum=tmp_path / "b.tum", poses="keyframes"))
    assert (tmp_path / "b.tum").read_bytes() == (run / "keyframes.tum").read_bytes()


def test_a_run_as_a_bag_has_the_map_and_transforms_that_give_its_poses(run, tmp_path):
    done = export(run, Targets(ros2=tmp_path / "bag"))
    assert not done.lost
    got = bag_messages(tmp_path / "bag")
    topics = {topic for topic, _, _ in got}
    assert topics >= {"/map", "/path", "/pose", "/odom", "/tf", "/tf_static", "/scan"}
    truth = read_tum(run / "trajectory.tum")
    transforms = {}
    for topic, _, message in got:
        if topic == "/tf":
            (t,) = message.transforms
            stamp = t.header.stamp.sec * 10**9 + t.header.stamp.nanosec
            q, x = t.transform.rotation, t.transform.translation
            transforms[t.header.frame_id, stamp] = np.array([x.x, x.y, 2 * math.atan2(q.z, q.w)])
    for stamp, pose in zip(truth.stamps_ns.tolist(), truth.poses, strict=True):
        (mx, my, mt), (ox, oy, ot) = transforms["map", stamp], transforms["odom", stamp]
        x = mx + math.cos(mt) * ox - math.sin(mt) * oy
        y = my + math.sin(mt) * ox + math.cos(mt) * oy
        np.testing.assert_allclose([x, y], pose[:2], rtol=0, atol=1e-9)
        assert abs(math.remainder(mt + ot - pose[2], math.tau)) < 1e-9


def test_what_is_not_there_is_named(log, run, tmp_path):
    out = tmp_path / "x"
    for source, targets, says in (
        (log, Targets(g2o=out), "a log has no graph"),
        (log, Targets(tum=out, poses="keyframes"), "no poses named 'keyframes': odometry, truth"),
        (run, Targets(tum=out, poses="truth"), "trajectory, keyframes, odometry"),
        (tmp_path, Targets(tum=out), "is no RUN"),
        (run, Targets(tum=tmp_path / "none" / "x"), "cannot be written"),
        (log, Targets(carmen=log), "would replace the log itself"),
    ):
        with pytest.raises(RunError, match=says):
            export(source, targets)
    assert list(tmp_path.iterdir()) == []


def test_the_map_of_a_run_is_in_its_tables_nowhere(run, tmp_path):
    export(run, Targets(csv=tmp_path / "tables"))
    with open_log(run / "run.mcap") as log:
        assert any(isinstance(m, OccupancyMap) for m in log.messages())
    names = {path.name for path in (tmp_path / "tables").iterdir()}
    assert {"scan.csv", "factor.csv", "keyframe.csv", "pose.csv"} <= names
    assert "map.csv" not in names


def test_a_log_is_not_imported_over_itself(drive, tmp_path):
    export(write(tmp_path / "drive.mcap", drive), Targets(carmen=tmp_path / "drive.log"))
    before = (tmp_path / "drive.log").read_bytes()
    with pytest.raises(LogError, match="name another file"):
        import_log(tmp_path / "drive.log", tmp_path / "drive.log")
    assert (tmp_path / "drive.log").read_bytes() == before


def planar(message):
    """Frames and pose of a foxglove.FrameTransform, or of a TransformStamped."""
    rotation = message.rotation
    yaw = 2 * math.atan2(rotation.z, rotation.w)
    return message.translation.x, message.translation.y, yaw


def chained(a, b):
    c, s = math.cos(a[2]), math.sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]


def test_a_runs_log_puts_itself_together_in_a_viewer(run, drive):
    """By an independent reader: frames from map to laser at every scan, maps on the way."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    trajectory = read_tum(run / "trajectory.tum")
    mounts, links, frames, maps = [], {}, {}, []
    with (run / "run.mcap").open("rb") as stream:
        for _, channel, raw, message in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            if channel.topic == "/tf":
                names = message.parent_frame_id, message.child_frame_id
                links[names, raw.publish_time] = planar(message)
                mounts += [raw.publish_time] if names == ("base", "laser") else []
            elif channel.topic == "/map":
                maps.append(raw.publish_time)
            if channel.topic in ("/scan", "/map", "/pose", "/truth", "/odom"):
                frames[channel.topic] = message.frame_id
    assert frames == {"/scan": "laser", "/map": "map", "/pose": "map", "/truth": "world"}
    assert mounts[0] <= trajectory.stamps_ns[0]
    for stamp, pose in zip(trajectory.stamps_ns.tolist(), trajectory.poses, strict=True):
        odom, base = links[("map", "odom"), stamp], links[("odom", "base"), stamp]
        assert chained(odom, base)[:2] == pytest.approx(pose[:2].tolist(), abs=1e-9)
        assert math.remainder(sum((odom[2], base[2], -pose[2])), math.tau) == pytest.approx(0)
    assert len(maps) == 4
    assert len(set(maps)) == 4
    first = next(m for m in drive if isinstance(m, TruePose))
    world = links[("map", "world"), int(trajectory.stamps_ns[0])]
    in_map = chained(world, (first.x, first.y, first.theta))
    assert in_map[:2] == pytest.approx(trajectory.poses[0][:2].tolist(), abs=1e-6)
    with open_log(run / "run.mcap") as log:  # our own readers pass over what is for viewers
        assert sum(1 for _ in log.messages(("/tf",))) == 1
        assert not log.skipped


def test_gtsam_reads_a_runs_graph_with_all_its_factors(run):
    import gtsam
    from slam.backend.g2o import read_g2o

    factors, values = gtsam.readG2o(str(run / "graph.g2o"), False)
    ours = read_g2o(run / "graph.g2o")
    assert factors.size() == len(ours.edges) > 0
    assert values.size() == len(ours.poses)
    graph = gtsam.NonlinearFactorGraph()
    for edge in ours.edges:
        noise = gtsam.noiseModel.Gaussian.Information(edge.information)
        graph.add(gtsam.BetweenFactorPose2(edge.i, edge.j, edge.i_T_j, noise))
    assert factors.error(values) == pytest.approx(graph.error(values), rel=1e-9)


def test_metadata_of_a_bag_can_be_read_by_every_release_of_ros_2(log, tmp_path):
    from ruamel.yaml import YAML

    export(log, Targets(ros2=tmp_path / "bag"))
    loaded = YAML(typ="safe").load((tmp_path / "bag" / "metadata.yaml").read_text())
    about = loaded["rosbag2_bagfile_information"]
    assert about["version"] <= 8
    for topic in about["topics_with_message_count"]:
        metadata = topic["topic_metadata"]
        assert isinstance(metadata["offered_qos_profiles"], str)
        (qos,) = YAML(typ="safe").load(metadata["offered_qos_profiles"])
        static = metadata["name"] in ("/tf_static", "/map", "/path")
        assert (qos["history"], qos["reliability"]) == (1, 1)
        assert qos["durability"] == (1 if static else 2)
