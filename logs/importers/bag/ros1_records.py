"""Records of ROS 1 bags, read without trusting what they say of their lengths."""

from __future__ import annotations

import struct
from typing import IO, NamedTuple

HEADER_LIMIT = 1 << 20  # bytes: V1.2 puts definitions into headers
_SEARCH_BLOCK = 1 << 16  # bytes looked through at a time for the next record
DEFINITION, MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(1, 8)
_OP = b"\x04\x00\x00\x00op="  # every header has this field
U32 = struct.Struct("<I")
BAD = (struct.error, ValueError, KeyError, IndexError)


class Record(NamedTuple):
    """Where a record's data lie, and the fields of its header."""

    fields: dict[bytes, bytes]
    data_at: int
    length: int  # bytes of data

    @property
    def operation(self) -> int:
        """What kind of record it is."""
        return self.fields[b"op"][0]


def record_at(file: IO[bytes], at: int, end: int) -> Record:
    """Return the record that begins at an offset.

    Raises:
        One of BAD: it is none, or does not end before `end`.
    """
    (length,) = U32.unpack(read_at(file, at, 4))
    if not 0 < length <= min(HEADER_LIMIT, end - at - 8):
        raise ValueError("impossible length of a header")
    head = read_at(file, at + 4, length + 4)
    fields = fields_of(head[:length])
    if len(fields[b"op"]) != 1:
        raise ValueError("no operation")
    (data_length,) = U32.unpack(head[length:])
    data_at = at + 8 + length
    operation = fields[b"op"][0]
    if operation == INDEX and b"conn" in fields:
        # Early recorders stated too many bytes here; 12 for each entry are what is there.
        data_length = 12 * U32.unpack(fields[b"count"])[0]
    if operation == CHUNK and fields[b"compression"] == b"none":
        data_length = min(data_length, end - data_at)  # the last one of a bag that is cut off
    if data_length > end - data_at:
        raise ValueError("a record is cut off")
    return Record(fields, data_at, data_length)


def fields_of(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header by name.

    Raises:
        One of BAD: they do not fit into it.
    """
    fields, at = {}, 0
    while at < len(header):
        (length,) = U32.unpack_from(header, at)
        name, equals, value = header[at + 4 : at + 4 + length].partition(b"=")
        at += 4 + length
        if not equals or at > len(header):
            raise ValueError("a field is cut off")
        fields[name] = value
    return fields


def next_record(file: IO[bytes], at: int, end: int) -> int:
    """Return where the next record begins, `end` if there is none.

    A header is looked for around its operation field, which may stand anywhere in it.
    """
    while at < end:
        block = _read_some(file, at, _SEARCH_BLOCK + len(_OP))
        found = block.find(_OP)
        if found < 0:
            at += _SEARCH_BLOCK
            continue
        operation_at = at + found
        for start in range(max(at, operation_at - 4096), operation_at - 3):
            try:
                record_at(file, start, end)
            except BAD:
                continue
            return start
        at = operation_at + 1
    return end


def read_at(file: IO[bytes], at: int, length: int) -> bytes:
    """Return so many bytes from an offset on.

    Raises:
        ValueError: there are fewer.
    """
    data = _read_some(file, at, length)
    if len(data) < length:
        raise ValueError("a record is cut off")
    return data


def _read_some(file: IO[bytes], at: int, length: int) -> bytes:
    file.seek(at)
    return file.read(length)
