"""What is inside of a chunk: compressed records, unpacked in bounded memory."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.opcode import Opcode
from slam.logs.mcap_file import RECORD_HEADER, RECORD_LIMIT, Damaged

_CHUNK = struct.Struct("<QQQII")  # start, end, unpacked size, CRC, length of compression's name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_STEP = 64 * 1024  # bytes unpacked at a time of a chunk that is cut off


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


class ChunkHeader(NamedTuple):
    """What a chunk says about itself."""

    start_ns: int  # first log time of its messages
    end_ns: int
    size: int  # bytes when unpacked
    crc: int  # of the unpacked bytes, 0 if there is none
    compression: bytes
    packed_length: int  # bytes
    packed_at: int  # where the packed bytes begin in the record's body


def chunk_header(body: bytes) -> ChunkHeader:
    """Return the header of a chunk whose body may be cut off behind it.

    Raises:
        Damaged: if the header is cut off or claims too large a chunk.
    """
    try:
        start_ns, end_ns, size, crc, name_length = _CHUNK.unpack_from(body)
        at = _CHUNK.size + name_length
        (packed_length,) = struct.unpack_from("<Q", body, at)
    except struct.error as error:
        raise Damaged("a chunk's header is cut off") from error
    if size > RECORD_LIMIT:
        raise Damaged(f"a chunk claims more than {RECORD_LIMIT >> 20} MiB")
    return ChunkHeader(start_ns, end_ns, size, crc, body[_CHUNK.size : at], packed_length, at + 8)


def unpack_chunk(body: bytes) -> bytes:
    """Return the records inside a chunk, checked against its CRC.

    Raises:
        Damaged: if the chunk is malformed, too large, or its CRC does not fit.
    """
    header = chunk_header(body)
    packed = body[header.packed_at :]
    if header.packed_length != len(packed):
        raise Damaged("a chunk's length is wrong")
    data = _decompress(header.compression, packed, header.size)
    if len(data) != header.size:
        raise Damaged("a chunk does not unpack to the size it claims")
    if header.crc and zlib.crc32(data) != header.crc:
        raise Damaged("a chunk's checksum is wrong")
    return data


def unpack_cut_chunk(body: bytes, length: int) -> bytes:
    """Return the first records of a chunk that should have `length` bytes but is cut off.

    Nothing checks them: the CRC is that of the whole.  zstd gives back its whole blocks
    (128 KiB when unpacked), so a small chunk gives nothing.

    Raises:
        Damaged: if the header contradicts the record's length, so that it is not a cut
            that spoilt it, or nothing can be unpacked.
    """
    header = chunk_header(body)
    if header.packed_at + header.packed_length != length:
        raise Damaged("a chunk's length is wrong")
    packed = body[header.packed_at :]
    if header.compression == b"zstd":
        return _first_blocks(packed, header.size)
    return _decompress(header.compression, packed, header.size)[: header.size]


def _first_blocks(packed: bytes, size: int) -> bytes:
    reader = zstandard.ZstdDecompressor(max_window_size=RECORD_LIMIT).stream_reader(BytesIO(packed))
    data = bytearray()
    try:
        while len(data) < size and (block := reader.read(min(_STEP, size - len(data)))):
            data += block
    except zstandard.ZstdError:
        pass  # the blocks before are whole
    return bytes(data)


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
        if len(data) - at < RECORD_HEADER.size:
            raise Damaged("a record within a chunk is cut off")
        opcode, length = RECORD_HEADER.unpack_from(data, at)
        at += RECORD_HEADER.size
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
