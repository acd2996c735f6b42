"""Everything that reads a log, on bytes of any origin: it must refuse or count, never fail."""

from __future__ import annotations

import struct
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from slam.logs import protos
from slam.logs.doctor import diagnose
from slam.logs.errors import LogError
from slam.logs.mcap_log import open_log
from slam.logs.messages import (
    DeviceHealth,
    FactorRecord,
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    LoopResult,
    Message,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    WheelOdometry,
)
from slam.logs.parts import Recording
from slam.logs.recover import recover
from slam.logs.schemas import CHANNELS, encode, topic_of

from slam.tools.inspect import describe_log

NINE = (0.1,) * 9
MESSAGES: tuple[Message, ...] = (
    LaserExtrinsics(1, 0.1, 0.0, 0.0),
    WheelOdometry(2, 1.0, 2.0, 3.0),
    LaserScan(3, -1.0, 0.1, np.ones(9, dtype=np.float32), 0.1, 30.0),
    RawBytes(4, "laser", "rx", b"MD0000\n"),
    PoseEstimate(5, 1.0, 2.0, 3.0, NINE),
    KeyframeDecision(6, 1, 2, "turn", "x", 0.1, 0.2, 0.3, 0.4, (1.0, 2.0), (0.1, 0.1, 0.1)),
    FactorRecord(7, "icp", 0, 1, 0.1, 0.2, 0.3, NINE),
    LoopResult(8, 0, 1, True, "accepted", 0.9, 0.1, 1.0),
    OccupancyMap(9, 0.05, 0.0, 0.0, np.zeros((3, 4), dtype=np.int8)),
    LogLine(10, "error", "laser", "lost"),
    DeviceHealth(11, "laser", "lost", ("scans",), ("7",)),
)


def plain_log(chunked: bool, summary: bool) -> bytes:
    """A log without checksums and compression, which would keep damage from the parsers."""
    out = BytesIO()
    kinds = IndexType.ALL if summary else IndexType.NONE
    writer = Writer(
        out, use_chunking=chunked, compression=CompressionType.NONE, enable_crcs=False,
        use_statistics=summary, use_summary_offsets=summary, chunk_size=300,
        repeat_channels=summary, repeat_schemas=summary, index_types=kinds,
    )  # fmt: skip
    writer.start()
    writer.add_metadata("run", {"schema_version": "1", "part": "0"})
    writer.add_attachment(0, 0, "config.json", "application/json", b"{}")
    for message in MESSAGES:
        channel = CHANNELS[topic_of(message)]
        schema = 0
        if channel.message:
            schema = writer.register_schema(
                channel.schema_name, "protobuf", protos.descriptor_set(channel.message)
            )
        number = writer.register_channel(channel.topic, channel.encoding, schema)
        writer.add_message(number, message.stamp_ns, encode(message), message.stamp_ns)
    writer.finish()
    return out.getvalue()


def read_every_way(path: Path) -> int:
    """Read a file in all the ways there are; returns the messages that one of them gave."""
    read = 0
    with suppress(LogError), open_log(path) as log:
        read = sum(1 for _ in log.receipts())
        log.counts(), log.metadata(), log.channels()
        list(log.attachments())
        assert all(count > 0 for count in log.skipped.values())
    with suppress(LogError):
        told = describe_log(path)
        assert all(line.isprintable() for line in told.split("\n"))
        assert len(told) < 100_000
    with suppress(LogError):
        assert all(finding.text.isprintable() for finding in diagnose(path).findings)
    with suppress(LogError):
        list(Recording(path).messages())
    out = path.with_suffix(".recovered")
    with suppress(LogError):
        recover(path, out)
    out.unlink(missing_ok=True)
    return read


WORDS = tuple(struct.pack("<Q", n) for n in (0, 1, 2**16, 2**31, 2**32 - 1, 2**62, 2**64 - 1))
