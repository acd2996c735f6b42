from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import (
    FactorRecord,
    LaserScan,
    Message,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    WheelOdometry,
)
from slam.logs.schemas import CHANNELS, decode, encode, topic_of

from tests.logs.strategies import content, messages, stamps


@given(messages)
@settings(max_examples=400, deadline=None)
def test_every_message_survives_to_the_last_bit(message: Message):
    again = decode(topic_of(message), message.stamp_ns, encode(message))
    assert content(again) == content(message)


@given(st.lists(st.tuples(messages, st.none() | stamps), max_size=12))
@settings(max_examples=40, deadline=None)
def test_a_file_gives_back_what_was_written_in_that_order(written):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        with LogWriter(path) as log:
            for message, receipt_ns in written:
                log.write(message, receipt_ns)
        with open_log(path) as log:
            read = list(log.receipts())
            assert not log.skipped
            assert sum(log.counts().values()) == len(written)
    assert [content(m) for _, m in read] == [content(m) for m, _ in written]
    wanted = [m.stamp_ns if receipt is None else receipt for m, receipt in written]
    assert [receipt for receipt, _ in read] == wanted


@pytest.mark.parametrize("topic", [t for t, c in CHANNELS.items() if c.message])
@given(st.binary(max_size=60))
@settings(max_examples=60, deadline=None)
def test_rubbish_on_a_channel_is_a_value_error_or_a_message(topic, data):
    try:
        decode(topic, 0, data)
    except ValueError:
        pass


@given(messages, st.data())
@settings(max_examples=200, deadline=None)
def test_a_cut_off_payload_is_a_value_error_or_a_message(message, data):
    payload = encode(message)
    try:
        decode(topic_of(message), 0, payload[: data.draw(st.integers(0, len(payload)))])
    except ValueError:
        pass


def test_other_readers_see_foxglove_messages_and_all_our_fields(tmp_path: Path):
    path = tmp_path / "a.mcap"
    scan = LaserScan(5, -1.0, 0.5, np.array([1, np.inf, 3], np.float32), 0.1, 30.0, 1e-4)
    with LogWriter(path) as log:
        log.write(scan, receipt_ns=9)
        log.write(PoseEstimate(6, 1.0, 2.0, 0.5, tuple(map(float, range(9))), lost=True))
        log.write(OccupancyMap(7, 0.05, 1.0, 2.0, np.array([[0, -1, 100]], np.int8)))
        log.write(FactorRecord(8, "icp", 1, 2, 0.1, 0.2, 0.3, (1.0,) * 9))
        log.write(RawBytes(9, "laser", "rx", b"\x00\x01"))
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == ""
        assert reader.get_header().library.startswith("sdp-slam/")
        raw = list(reader.iter_messages(log_time_order=False))
        seen = {
            schema.name: (message, decoded)
            for schema, _, message, decoded in reader.iter_decoded_messages(
                [t for t, c in CHANNELS.items() if c.message], log_time_order=False
            )
        }
    assert [(s.name if s else None) for s, _, _ in raw][-1] is None  # bytes have no schema
    message, decoded = seen["foxglove.LaserScan"]
    assert (message.log_time, message.publish_time) == (9, 5)
    assert list(decoded.ranges) == [1.0, np.inf, 3.0]
    assert (decoded.start_angle, decoded.end_angle) == (-1.0, 0.0)
    assert (decoded.slam.range_max, decoded.timestamp.nanos) == (30.0, 5)
    pose = seen["foxglove.Odometry"][1]
    assert (pose.frame_id, pose.body_frame_id) == ("map", "base")
    assert np.array(pose.pose_covariance).reshape(6, 6)[5, 1] == 7.0
    assert np.isclose(2 * np.arctan2(pose.pose.orientation.z, pose.pose.orientation.w), 0.5)
    assert seen["foxglove.Grid"][1].column_count == 3
    assert seen["slam.v1.FactorRecord"][1].kind == "icp"


def test_a_foxglove_scan_of_another_program_is_read(tmp_path: Path):
    from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan as FoxgloveScan
    from mcap_protobuf.writer import Writer

    buffer = io.BytesIO()
    theirs = FoxgloveScan(start_angle=-1.0, end_angle=1.0, ranges=[1.0, 2.0, 3.0])
    with Writer(buffer) as writer:
        writer.write_message("/scan", theirs, log_time=4, publish_time=3)
    path = tmp_path / "foreign.mcap"
    path.write_bytes(buffer.getvalue())
    with open_log(path) as log:
        (scan,) = log.messages()
    assert isinstance(scan, LaserScan)
    assert (scan.stamp_ns, scan.angle_min, scan.angle_step) == (3, -1.0, 1.0)
    assert scan.ranges.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "message",
    [
        WheelOdometry(-1, 0.0, 0.0, 0.0),
        WheelOdometry(2**63, 0.0, 0.0, 0.0),
        PoseEstimate(0, 0.0, 0.0, 0.0, (1.0, 2.0)),
        FactorRecord(0, "icp", 2**70, 0, 0.0, 0.0, 0.0, ()),
        FactorRecord(0, "icp", 0, 0, 0.0, 0.0, 0.0, (), note="\ud800"),
    ],
)
def test_what_the_format_cannot_hold_is_refused_and_the_log_goes_on(tmp_path: Path, message):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        with pytest.raises(LogError, match=r"a\.mcap"):
            log.write(message)
        log.write(WheelOdometry(1, 1.0, 2.0, 3.0))
    with open_log(path) as log:
        assert len(list(log.messages())) == 1


def test_topics_can_be_chosen(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        log.write(WheelOdometry(1, 1.0, 2.0, 3.0))
        log.write(RawBytes(1, "laser", "tx", b"BM\n"))
    with open_log(path) as log:
        assert [type(m) for m in log.messages({"/raw/laser/tx"})] == [RawBytes]
        assert list(log.messages([])) == []
        assert log.counts() == {"/odom": 1, "/raw/laser/tx": 1}
