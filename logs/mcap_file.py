"""The records of an MCAP file, read without trusting it.

The `mcap` package's readers believe what a file says about lengths; here each length is
checked against the file and a limit before anything is allocated, so that a hostile or
damaged file costs bounded memory.  See the format's specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment

MAGIC = b"\x89MCAP0\r\n"
FOOTER_BODY = struct.Struct("<QQI")  # summary start, summary offset start, summary CRC
FOOTER_LENGTH = 9 + FOOTER_BODY.size
RECORD_LIMIT = 64 * 2**20
"""Largest record, and largest chunk when unpacked, that is read into memory (bytes)."""

_HEADER = struct.Struct("<BQ")  # opcode, length of the body
_CHUNK = struct.Struct("<QQQII")  # start, end, unpacked size, CRC, length of compression's name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_MESSAGE_INDEX = struct.Struct("<HI")  # channel, bytes of entries of 16 bytes


class Damaged(Exception):  # noqa: N818 - caught within `logs` and turned into counts
    """A record is not what the format says; the message is short, for counting causes."""


class Record(NamedTuple):
    """Where a record lies in the file."""

    opcode: int
    start: int  # of its header
    length: int  # bytes of its body

    @property
    def end(self) -> int:
        """The offset just after the record."""
        return self.start + _HEADER.size + self.length


class RawMessage(NamedTuple):
    """A message as it lies in the file."""

    channel_id: int
    sequence: int
    log_time: int  # ns, when it was received
    publish_time: int  # ns, when it was true
    data: bytes


@dataclass(frozen=True, slots=True)
class Inner:
    """A schema or channel record, by opcode and body."""

    opcode: int
    body: bytes


def walk(file: IO[bytes], start: int, end: int) -> Iterator[Record]:
    """Yield the records between two offsets; bodies are not read.

    Raises:
        Damaged: at the first record that is cut off or claims to end after `end`.
    """
    while start < end:
        file.seek(start)
        header = file.read(_HEADER.size)
        if len(header) < _HEADER.size:
            raise Damaged("a record is cut off")
        record = Record(*_read_header(header, start))
        if record.end > end:
            raise Damaged("a record claims more bytes than the file has")
        yield record
        start = record.end


def _read_header(header: bytes, start: int) -> tuple[int, int, int]:
    opcode, length = _HEADER.unpack(header)
    return opcode, start, length


def read_body(file: IO[bytes], record: Record) -> bytes:
    """Return a record's body.

    Raises:
        Damaged: if it is larger than `RECORD_LIMIT` or cut off.
    """
    if record.length > RECORD_LIMIT:
        raise Damaged(f"a record is larger than {RECORD_LIMIT >> 20} MiB")
    file.seek(record.start + _HEADER.size)
    body = file.read(record.length)
    if len(body) < record.length:
        raise Damaged("a record is cut off")
    return body


def stream(body: bytes) -> ReadDataStream:
    """Wrap a body for the `read` methods of `mcap.records`; they cannot read beyond it."""
    return ReadDataStream(BytesIO(body))


def chunk_times(body: bytes) -> tuple[int, int]:
    """Return the first and last log time that a chunk, perhaps cut off, claims (ns)."""
    if len(body) < _CHUNK.size:
        raise Damaged("a chunk is cut off")
    start, end, *_ = _CHUNK.unpack_from(body)
    return start, end


def unpack_chunk(body: bytes) -> bytes:
    """Return the records inside a chunk, checked against its CRC.

    Raises:
        Damaged: if the chunk is malformed, too large, or its CRC does not fit.
    """
    try:
        _, _, size, crc, name_length = _CHUNK.unpack_from(body)
        at = _CHUNK.size
        compression = body[at : at + name_length]
        (packed_length,) = struct.unpack_from("<Q", body, at + name_length)
    except struct.error as error:
        raise Damaged("a chunk's header is cut off") from error
    packed = body[at + name_length + 8 :]
    if packed_length != len(packed):
        raise Damaged("a chunk's length is wrong")
    if size > RECORD_LIMIT:
        raise Damaged(f"a chunk claims more than {RECORD_LIMIT >> 20} MiB")
    data = _decompress(compression, packed, size)
    if len(data) != size:
        raise Damaged("a chunk does not unpack to the size it claims")
    if crc and zlib.crc32(data) != crc:
        raise Damaged("a chunk's checksum is wrong")
    return data


def _decompress(compression: bytes, packed: bytes, size: int) -> bytes:
    """Unpack without allocating more than `size`, whatever the compressed frame claims."""
    try:
        if compression == b"zstd":
            claimed = zstandard.get_frame_parameters(packed).content_size
            if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise Damaged("a chunk does not unpack to the size it claims")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size or 1)
        if compression == b"lz4":
            unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
            return unpacked
    except (zstandard.ZstdError, RuntimeError) as error:
        raise Damaged("a chunk cannot be unpacked") from error
    if compression:
        raise Damaged("a chunk's compression is unknown")
    return packed


def inner_records(data: bytes) -> Iterator[RawMessage | Inner]:
    """Yield the messages, schemas and channels of an unpacked chunk, in file order.

    Raises:
        Damaged: at the first record that does not fit into the chunk.
    """
    at = 0
    while at < len(data):
        if len(data) - at < _HEADER.size:
            raise Damaged("a record within a chunk is cut off")
        opcode, length = _HEADER.unpack_from(data, at)
        at += _HEADER.size
        if length > len(data) - at:
            raise Damaged("a record within a chunk is cut off")
        if opcode == Opcode.MESSAGE:
            yield message_of(data, at, at + length)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield Inner(opcode, data[at : at + length])
        at += length


def message_of(data: bytes, start: int, end: int) -> RawMessage:
    """Return the message whose body lies between two offsets."""
    if end - start < _MESSAGE.size:
        raise Damaged("a message is cut off")
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
    payload = data[start + _MESSAGE.size : end]
    return RawMessage(channel, sequence, log_time, publish_time, payload)


def attachment_of(body: bytes) -> Attachment:
    """Return an attachment, checked against its CRC (0 means that there is none).

    Raises:
        Damaged: if it is not as it was written.
    """
    try:
        attachment: Attachment = Attachment.read(stream(body))
    except PARSE_ERRORS as error:
        raise Damaged("an attachment is malformed") from error
    crc = int.from_bytes(body[-4:], "little")
    if crc and zlib.crc32(body[:-4]) != crc:
        raise Damaged("an attachment's checksum is wrong")
    return attachment


def indexed_messages(body: bytes) -> int:
    """Return how many messages a message index counts; 0 if it is malformed."""
    if len(body) < _MESSAGE_INDEX.size:
        return 0
    _, entries = _MESSAGE_INDEX.unpack_from(body)
    return int(min(entries, len(body) - _MESSAGE_INDEX.size)) // 16


PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError)
"""What `mcap.records` raises on a malformed body (ValueError holds bad UTF-8)."""
