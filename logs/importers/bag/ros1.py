"""ROS 1 bags by their records: V2.0 and V1.2, indexed or not, closed or not, damaged or not.

The index at the end of a bag is not needed: its messages lie in records one behind the
other, in chunks since V2.0 (the format is on the ROS wiki, "Bags/Format").  `rosbags` reads
by the index alone and refuses a bag whose index is missing or wrong.  After damage the next
record is searched for by its operation field.
"""

from __future__ import annotations

import bz2
import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO

import lz4.frame  # type: ignore[import-untyped]
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.channels import Account, BagMessage, Channel, Wanted, ros2_name
from slam.logs.importers.bag.ros1_records import (
    BAD,
    BAG,
    CHUNK,
    CONNECTION,
    DEFINITION,
    MESSAGE,
    U32,
    Record,
    fields_of,
    next_record,
    read_at,
    record_at,
)

MAGICS = {b"#ROSBAG V2.0\n": "2.0", b"#ROSRECORD V1.2\n": "1.2", b"#ROSBAG V1.2\n": "1.2"}
CHUNK_LIMIT = 256 << 20  # bytes of a chunk when unpacked; recorders make 768 KiB


class Ros1Bag:
    """A ROS 1 bag."""

    kind = "ROS bag"

    def __init__(self, path: Path) -> None:
        """Look at the first bytes.

        Raises:
            LogError: the version is one that cannot be read.
        """
        self._path = path
        with path.open("rb") as file:
            first = file.readline(64)
        if first not in MAGICS:
            version = shown(first.decode("latin1").strip())
            raise LogError(
                f"{path}: is a ROS bag of a version that cannot be read ({version}): convert it "
                "with `rosbag fix` of ROS 1"
            )
        self._start = len(first)

    def messages(self, wanted: Wanted, account: Account) -> Iterator[BagMessage]:
        """Yield the wanted messages, record by record."""
        walk = _Walk(wanted, account)
        try:
            with self._path.open("rb") as file:
                end = os.fstat(file.fileno()).st_size
                yield from walk.region(file, self._start, end)
        except OSError as error:
            raise LogError(f"{self._path}: cannot be read: {error.strerror}") from error
        if not walk.closed:
            account.skipped["end of the bag: it was not closed"] += 1


class _Walk:
    """One pass over a bag."""

    def __init__(self, wanted: Wanted, account: Account) -> None:
        self.closed = False
        self._wanted, self._account = wanted, account
        self._channels: dict[bytes, Channel] = {}  # by connection number, or topic in V1.2

    def region(self, file: IO[bytes], start: int, end: int) -> Iterator[BagMessage]:
        """Yield the messages of the records between two offsets of a file or a chunk."""
        at = start
        while at < end:
            try:
                record = record_at(file, at, end)
            except BAD:
                following = next_record(file, at + 1, end)
                cut = following >= end
                cause = "rest of the bag: it is cut off" if cut else "damaged pieces of the bag"
                self._account.skipped[cause] += 1
                at = following
                continue
            at = record.data_at + record.length
            yield from self._read(file, record, end)

    def _read(self, file: IO[bytes], record: Record, end: int) -> Iterator[BagMessage]:
        operation = record.operation
        try:
            if operation == MESSAGE:
                yield from self._message(file, record)
            elif operation == CHUNK:
                yield from self._chunk(file, record)
            elif operation == CONNECTION:
                inner = fields_of(read_at(file, record.data_at, record.length))
                self._define(record.fields[b"conn"], record.fields[b"topic"], inner)
            elif operation == DEFINITION:
                topic = record.fields[b"topic"]
                self._define(topic, topic, record.fields)
            elif operation == BAG:
                (index_at,) = struct.unpack("<Q", record.fields[b"index_pos"])
                self.closed = 0 < index_at <= end
        except BAD:
            self._account.skipped["damaged records"] += 1

    def _define(self, key: bytes, topic: bytes, about: dict[bytes, bytes]) -> None:
        if key not in self._channels:
            definition = about.get(b"message_definition", about.get(b"def", b""))
            name = topic.decode("utf-8", "replace")
            self._channels[key] = Channel(
                name if name.startswith("/") else f"/{name}",
                ros2_name(about[b"type"].decode("ascii", "replace")),
                "ros1",
                definition.decode("utf-8", "replace"),
                "ros1msg",
            )

    def _message(self, file: IO[bytes], record: Record) -> Iterator[BagMessage]:
        fields = record.fields
        channel = self._channels.get(fields[b"conn"] if b"conn" in fields else fields[b"topic"])
        if channel is None:
            self._account.skipped["messages of a connection that is nowhere described"] += 1
            return
        self._account.counts[channel] += 1
        if self._wanted(channel):
            if b"time" in fields:
                seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
            else:
                seconds = U32.unpack(fields[b"sec"])[0]
                nanoseconds = U32.unpack(fields[b"nsec"])[0]
            data = read_at(file, record.data_at, record.length)
            yield BagMessage(channel, seconds * 10**9 + nanoseconds, data)

    def _chunk(self, file: IO[bytes], record: Record) -> Iterator[BagMessage]:
        compression = record.fields[b"compression"]
        if compression == b"none":
            yield from self.region(file, record.data_at, record.data_at + record.length)
            return
        (size,) = U32.unpack(record.fields[b"size"])
        if size > CHUNK_LIMIT or record.length > CHUNK_LIMIT:
            self._account.skipped["chunks that claim impossible sizes"] += 1
            return
        data = _unpacked(compression, read_at(file, record.data_at, record.length), size)
        if len(data) < size:
            self._account.skipped["chunks that cannot be unpacked, or not wholly"] += 1
        yield from self.region(BytesIO(data), 0, len(data))


def _unpacked(compression: bytes, packed: bytes, size: int) -> bytes:
    """Return what can be unpacked of a chunk, never more than `size` bytes."""
    data = bytearray()
    unpacker = bz2.BZ2Decompressor() if compression == b"bz2" else lz4.frame.LZ4FrameDecompressor()
    try:
        while len(data) < size and not unpacker.eof:
            step = unpacker.decompress(packed, max_length=min(1 << 20, size - len(data)))
            packed = b""
            if not step:
                break
            data += step
    except (OSError, RuntimeError, EOFError):
        pass  # what came before it stands
    return bytes(data)
