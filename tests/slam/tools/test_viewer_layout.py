"""A RUN and its ROS 2 bag assemble in a viewer: frames, maps along the way, and the layout file."""

import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gtsam import Pose2

pytest.importorskip("rosbags", reason="the extra [ros] is not installed")

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter

from slam.runs.config_file import load_config
from slam.runs.replay import replay
from slam.tools.exports import Targets, export

LAYOUT = Path(__file__).parents[3] / "docs" / "foxglove-layout.json"
SHARED = {"/map", "/scan", "/pose", "/truth"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("viewer")
    with LogWriter(folder / "drive.mcap") as log:
        for message in simulate(scenario("testbed-180cm")):
            log.write(message)
    replay(folder / "drive.mcap", folder / "run", load_config(None))
    export(folder / "run", Targets(ros2=folder / "bag"))
    return folder


class Seen:
    """Times (ns) of the messages by topic, and frames by parent and child."""

    def __init__(self) -> None:
        self.times = defaultdict(list)
        self.links = defaultdict(dict)

    def frames(self):
        return {frame for link in self.links for frame in link}


@pytest.fixture(scope="module")
def own(run):
    seen = Seen()
    with (run / "run" / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            stamp = message.timestamp if hasattr(message, "timestamp") else None
            at = stamp.ToNanoseconds() if stamp is not None else 0
            seen.times[channel.topic].append(at)
            if channel.topic == "/tf":
                link = message.parent_frame_id, message.child_frame_id
                q, t = message.rotation, message.translation
                seen.links[link][at] = Pose2(t.x, t.y, 2.0 * np.arctan2(q.z, q.w))
    return seen


@pytest.fixture(scope="module")
def ros(run):
    seen = Seen()
    with AnyReader([run / "bag"]) as bag:
        for connection, _, data in bag.messages():
            message = bag.deserialize(data, connection.msgtype)
            if connection.msgtype == "tf2_msgs/msg/TFMessage":
                for one in message.transforms:
                    at = nanoseconds(one.header)
                    q, t = one.transform.rotation, one.transform.translation
                    link = one.header.frame_id, one.child_frame_id
                    seen.links[link][at] = Pose2(t.x, t.y, 2.0 * np.arctan2(q.z, q.w))
            seen.times[connection.topic].append(
                nanoseconds(message.header) if hasattr(message, "header") else 0
            )
    return seen


def nanoseconds(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.mark.parametrize(("which", "base"), [("own", "base"), ("ros", "base_link")])
def test_frames_at_every_scan_and_maps_along_the_way(request, which, base):
    seen = request.getfixturevalue(which)
    scans = seen.times["/scan"]  # of the keyframes
    assert len(scans) > 4
    assert len(seen.links["map", "odom"]) == 74  # at every scan of the drive
    for link in (("map", "odom"), ("odom", base)):
        assert set(scans) <= seen.links[link].keys(), link
    assert (base, "laser") in seen.links
    assert ("map", "world") in seen.links
    maps = seen.times["/map"]
    assert len(maps) >= 2
    assert all(a <= b for a, b in pairwise(maps))
    assert maps[0] < scans[-1]


def test_both_put_the_robot_at_the_same_place(own, ros):
    for at in own.times["/scan"]:
        a = own.links["map", "odom"][at] * own.links["odom", "base"][at]
        b = ros.links["map", "odom"][at] * ros.links["odom", "base_link"][at]
        assert a.equals(b, 1e-6)


def test_the_layout_names_only_what_is_there(own, ros):
    panels = json.loads(LAYOUT.read_text())["configById"]
    shown = panels["3D!run"]
    topics = shown["topics"].keys()
    assert topics <= own.times.keys()
    assert topics <= ros.times.keys()
    assert topics >= SHARED
    frames = {name.removeprefix("frame:") for name in shown["transforms"]} | {shown["followTf"]}
    assert frames <= own.frames() | ros.frames()
    assert {"map"} <= own.frames() & ros.frames()
    plotted = {path["value"].split(".")[0] for path in panels["Plot!closures"]["paths"]}
    assert plotted <= own.times.keys() | {"/loop"}  # of a drive that closes loops
