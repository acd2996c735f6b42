"""The records of an MCAP file, read without trusting it; `mcap_chunk` looks inside of chunks.

The `mcap` package's readers believe what a file says about lengths; here each length is
checked against the file and a limit before anything is allocated, so that a hostile or
damaged file costs bounded memory.  See the format's specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment

MAGIC = b"\x89MCAP0\r\n"
FOOTER_BODY = struct.Struct("<QQI")  # summary start, summary offset start, summary CRC
FOOTER_LENGTH = 9 + FOOTER_BODY.size
RECORD_LIMIT = 64 * 2**20
"""Largest record, and largest chunk when unpacked, that is read into memory (bytes)."""

RECORD_HEADER = struct.Struct("<BQ")  # opcode, length of the body
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
        return self.start + RECORD_HEADER.size + self.length


def walk(file: IO[bytes], start: int, end: int) -> Iterator[Record]:
    """Yield the records between two offsets; bodies are not read.

    Raises:
        Damaged: at the first record that is cut off or claims to end after `end`.
    """
    while start < end:
        file.seek(start)
        header = file.read(RECORD_HEADER.size)
        if len(header) < RECORD_HEADER.size:
            raise Damaged("a record is cut off")
        record = Record(*_read_header(header, start))
        if record.end > end:
            raise Damaged("a record claims more bytes than the file has")
        yield record
        start = record.end


def _read_header(header: bytes, start: int) -> tuple[int, int, int]:
    opcode, length = RECORD_HEADER.unpack(header)
    return opcode, start, length


def read_body(file: IO[bytes], record: Record) -> bytes:
    """Return a record's body.

    Raises:
        Damaged: if it is larger than `RECORD_LIMIT` or cut off.
    """
    if record.length > RECORD_LIMIT:
        raise Damaged(f"a record is larger than {RECORD_LIMIT >> 20} MiB")
    file.seek(record.start + RECORD_HEADER.size)
    body = file.read(record.length)
    if len(body) < record.length:
        raise Damaged("a record is cut off")
    return body


def stream(body: bytes) -> ReadDataStream:
    """Wrap a body for the `read` methods of `mcap.records`; they cannot read beyond it."""
    return ReadDataStream(BytesIO(body))


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
