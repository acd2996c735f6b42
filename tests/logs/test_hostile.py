"""Files made to hurt: refused or skipped with a count, in bounded memory."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Header, Message, Schema
from mcap.writer import Writer
from slam.logs.doctor import diagnose
from slam.logs.errors import LogError, shown
from slam.logs.info import read_info
from slam.logs.mcap_file import MAGIC
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import LaserScan, LoopResult, WheelOdometry
from slam.logs.protos import descriptor_set
from slam.logs.recover import recover
from slam.logs.schemas import encode


def channel_records(topic: str = "/odom") -> bytes:
    builder = RecordBuilder()
    schema = descriptor_set("Odometry")
    Schema(1, schema, "protobuf", "foxglove.Odometry").write(builder)
    Channel(1, topic, "protobuf", {}, 1).write(builder)
    return builder.end()


def message_record(data: bytes, channel: int = 1, publish_time: int = 0) -> bytes:
    builder = RecordBuilder()
    Message(channel, 0, data, publish_time, 0).write(builder)
    return builder.end()


def chunk_record(packed: bytes, size: int, compression: str = "zstd") -> bytes:
    builder = RecordBuilder()
    Chunk(compression, packed, 0, 0, 0, size).write(builder)
    return builder.end()


def mcap_of(path: Path, *parts: bytes) -> Path:
    """Write a closed MCAP file without a summary around the given records."""
    head, tail = RecordBuilder(), RecordBuilder()
    Header("", "x").write(head)
    DataEnd(0).write(tail)
    Footer(0, 0, 0).write(tail)
    path.write_bytes(MAGIC + head.end() + b"".join(parts) + tail.end() + MAGIC)
    return path


GOOD = message_record(encode(WheelOdometry(0, 1.0, 2.0, 3.0)))
BOMB = zstandard.compress(bytes(200_000_000))


@pytest.mark.parametrize(
    ("record", "cause"),
    [
        (chunk_record(b"x", 2**62), "claims more than"),
        (chunk_record(BOMB, 200_000_000), "claims more than"),
        (chunk_record(BOMB, 1000), "size it claims"),
        (chunk_record(b"no zstd frame", 1000), "cannot be unpacked"),
        (chunk_record(b"no lz4 frame", 1000, "lz4"), "cannot be unpacked"),
        (chunk_record(b"x", 1, "zip"), "compression is unknown"),
        (chunk_record(b"\x05" + struct.pack("<Q", 2**60), 9, ""), "within a chunk is cut off"),
        (b"\x06" + struct.pack("<Q", 3) + b"abc", "cut off"),
        (message_record(b"\xff" * 20), "/odom: not a foxglove.Odometry"),
        (message_record(b"", publish_time=2**64 - 1), "2262"),
        (message_record(b"", channel=77), "nowhere described"),
    ],
)
def test_bad_records_are_skipped_and_counted(tmp_path: Path, record: bytes, cause: str):
    path = mcap_of(tmp_path / "a.mcap", channel_records(), GOOD, record, GOOD)
    tracemalloc.start()
    with open_log(path) as log:
        read = list(log.messages())
        assert [type(m) for m in read] == [WheelOdometry, WheelOdometry]
        ((said, count),) = log.skipped.items()
    recover(path, tmp_path / "b.mcap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert cause in said
    assert count == 1
    assert peak < 5_000_000


def test_a_record_longer_than_the_file_ends_the_reading(tmp_path: Path):
    path = mcap_of(
        tmp_path / "a.mcap", channel_records(), GOOD, b"\x05" + struct.pack("<Q", 2**62), GOOD
    )
    with pytest.raises(LogError, match="more bytes than the file has"):
        open_log(path)
    report = recover(path, tmp_path / "b.mcap")
    assert report.messages == {"/odom": 1}
    assert report.lost


def test_thousands_of_bad_records_are_counted_in_bounded_memory(tmp_path: Path):
    bad = b"\x05" + struct.pack("<Q", 3) + b"abc"
    path = mcap_of(tmp_path / "a.mcap", channel_records(), GOOD, bad * 20_000)
    with open_log(path) as log:
        assert len(list(log.messages())) == 1
        assert log.skipped == {"messages lost: a message is cut off": 20_000}
    report = recover(path, tmp_path / "b.mcap")
    assert len(report.problems) == 1001
    assert report.problems[-1] == "and 19000 more"
    assert report.lost_bytes == 20_000 * len(bad)


def test_control_characters_and_markup_are_data_and_never_shown_raw(tmp_path: Path):
    evil = "<script>alert(1)</script>[red]\x1b]0;title\x07\r\n"
    with LogWriter(tmp_path / "a.mcap", {"robot": evil}) as log:
        log.add_metadata(evil, {evil: evil})
        log.add_metadata("recording", {f"dropped {evil}": "1"})
        log.write(LoopResult(0, 0, 1, False, evil, 0.0, 0.0, 0.0))
    with open_log(tmp_path / "a.mcap") as log:
        (closure_result,) = log.messages()
        assert closure_result.reason == evil
    info = read_info(tmp_path / "a.mcap")
    assert info.run["robot"] == evil
    assert shown(info.run["robot"]).isprintable()
    assert all(f.text.isprintable() for f in diagnose(tmp_path / "a.mcap").findings)


def test_a_second_laser_on_a_topic_of_its_own_is_named_and_not_read(tmp_path: Path):
    scan = LaserScan(0, 0.0, 0.1, np.ones(9, dtype=np.float32))
    data = encode(scan)
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(
            "foxglove.LaserScan", "protobuf", descriptor_set("LaserScan")
        )
        for topic in ("/scan", "/rear\x1b[2J"):
            channel = writer.register_channel(topic, "protobuf", schema)
            for stamp in (10, 20):
                writer.add_message(channel, stamp, data, stamp)
        writer.finish()
    with open_log(tmp_path / "a.mcap") as log:
        assert [m.stamp_ns for m in log.messages()] == [10, 20]
        assert not log.skipped
    other = [f for f in diagnose(tmp_path / "a.mcap").findings if f.code == "another-laser"]
    assert [f.topic for f in other] == ["/rear\\x1b[2J"]
    assert {c.topic: c.known for c in read_info(tmp_path / "a.mcap").channels} == {
        "/scan": True,
        "/rear\x1b[2J": False,
    }


def test_attachments_with_unsafe_names_or_lengths_are_skipped(tmp_path: Path):
    builder = RecordBuilder()
    for name in ("../../.bashrc", "/etc/passwd", "ok.toml"):
        Attachment(0, 0, name, "text/plain", b"data").write(builder)
    lying = b"\x09" + struct.pack("<QQQII", 28 + 8, 0, 0, 0, 0) + struct.pack("<Q", 2**40)
    path = mcap_of(tmp_path / "a.mcap", channel_records(), builder.end(), lying)
    with open_log(path) as log:
        assert [a.name for a in log.attachments()] == ["ok.toml"]
        assert log.skipped == {
            "attachment with an unsafe name": 2,
            "an attachment is malformed": 1,
        }


def test_a_damaged_attachment_is_not_handed_out(tmp_path: Path):
    builder = RecordBuilder()
    Attachment(0, 0, "ok.toml", "text/plain", b"speed = 1").write(builder)
    damaged = builder.end().replace(b"speed = 1", b"speed = 9")
    path = mcap_of(tmp_path / "a.mcap", channel_records(), GOOD, damaged)
    with open_log(path) as log:
        assert list(log.attachments()) == []
        assert log.skipped == {"an attachment's checksum is wrong": 1}
    assert recover(path, tmp_path / "b.mcap").lost


@pytest.mark.parametrize("chunked", [False, True])
def test_a_foreign_file_without_a_summary_is_refused_too(tmp_path: Path, chunked: bool):
    data = channel_records("/camera") + GOOD * 3
    part = chunk_record(data, len(data), "") if chunked else data
    with pytest.raises(LogError, match=r"none of our channels, only /camera"):
        open_log(mcap_of(tmp_path / "a.mcap", part))


def test_our_channel_behind_a_foreign_one_is_found_without_a_summary(tmp_path: Path):
    foreign = channel_records("/camera") + GOOD
    ours = channel_records().replace(
        b"\x01\x00\x01\x00\x05\x00\x00\x00/odom", b"\x02\x00\x01\x00\x05\x00\x00\x00/odom"
    ) + message_record(encode(WheelOdometry(0, 1.0, 2.0, 3.0)), channel=2)
    path = mcap_of(tmp_path / "a.mcap", foreign, ours)
    with open_log(path) as log:
        assert len(list(log.messages())) == 1
        assert not log.skipped


def test_a_log_is_read_without_holding_it_in_memory(tmp_path: Path):
    data = channel_records() + GOOD * 2_000
    chunk = chunk_record(zstandard.compress(data), len(data))
    path = mcap_of(tmp_path / "a.mcap", *[chunk] * 20)
    tracemalloc.start()
    with open_log(path) as log:
        assert sum(1 for _ in log.messages()) == 40_000
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * len(data)
