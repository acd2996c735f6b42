"""What an MCAP file says about itself at its end, and the checks that it has an end."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap import records
from mcap.opcode import Opcode
from slam.logs.errors import LogError, TruncatedLog
from slam.logs.mcap_file import (
    FOOTER_BODY,
    FOOTER_LENGTH,
    MAGIC,
    PARSE_ERRORS,
    Damaged,
    Record,
    read_body,
    stream,
    walk,
)

_BLOCK = 1 << 20


@dataclass(slots=True)
class Summary:
    """What the end of a file lists; empty for a file without a summary."""

    data_end: int  # offset where the data section ends
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    statistics: records.Statistics | None = None
    attachments: list[int] = field(default_factory=list)  # offsets of the records
    metadata: list[int] = field(default_factory=list)

    def note(self, opcode: int, body: bytes) -> None:
        """Take in one record of a kind that is kept here; others are passed over."""
        source = stream(body)
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(source)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = records.Channel.read(source)
            self.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            self.statistics = records.Statistics.read(source)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self.attachments.append(records.AttachmentIndex.read(source).offset)
        elif opcode == Opcode.METADATA_INDEX:
            self.metadata.append(records.MetadataIndex.read(source).offset)


def open_file(path: Path) -> IO[bytes]:
    """Open a file that begins like an MCAP file.

    Raises:
        LogError: one clear line for whatever else it is.
    """
    if path.is_dir():
        raise LogError(f"{path}: is a folder, not a log: name the .mcap file in it")
    try:
        file = path.open("rb")
    except FileNotFoundError as error:
        raise LogError(f"{path}: there is no such file: check the name") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    with_magic = file.read(len(MAGIC))
    if with_magic == MAGIC:
        return file
    file.close()
    if not with_magic:
        raise LogError(f"{path}: is empty: nothing was recorded")
    if with_magic.startswith((b"#ROSBAG", b"#ROSRECO", b"SQLite f")):
        raise LogError(
            f"{path}: is a ROS bag: `slam import {path} --out LOG.mcap` reads what is intact of "
            "it, closed or not"
        )
    raise LogError(
        f"{path}: is not an MCAP log: convert CARMEN and other logs with "
        f"`slam import {path} --out LOG.mcap`"
    )


def read_header(file: IO[bytes]) -> tuple[str, str]:
    """Return the profile and the library that a file names at its start; empty if damaged."""
    try:
        record = next(walk(file, len(MAGIC), os.fstat(file.fileno()).st_size))
        if record.opcode != Opcode.HEADER:
            return "", ""
        header = records.Header.read(stream(read_body(file, record)))
    except (Damaged, StopIteration, *PARSE_ERRORS):
        return "", ""
    return header.profile, header.library


def read_summary(file: IO[bytes], path: Path) -> Summary:
    """Read the summary at the end of a file.

    Raises:
        TruncatedLog: if the file has no proper end.
    """
    size = os.fstat(file.fileno()).st_size
    footer_at = size - FOOTER_LENGTH - len(MAGIC)
    try:
        if footer_at < len(MAGIC):
            raise Damaged("it ends in its first records")
        file.seek(size - len(MAGIC))
        if file.read() != MAGIC:
            raise Damaged("it ends in the middle of a record")
        footer = Record(Opcode.FOOTER, footer_at, FOOTER_BODY.size)
        start, _, crc = FOOTER_BODY.unpack(read_body(file, footer))
        if start == 0:
            return _scanned(file, footer_at)
        if not len(MAGIC) <= start <= footer_at:
            raise Damaged("its index lies outside of it")
        if crc and _crc(file, start, size - len(MAGIC) - 4) != crc:
            raise Damaged("its index is damaged")
        return _listed(file, start, footer_at)
    except (Damaged, *PARSE_ERRORS) as error:
        raise TruncatedLog(
            f"{path}: was not closed properly ({error}): run `slam recover {path} --out FILE2`"
        ) from error


def _listed(file: IO[bytes], start: int, end: int) -> Summary:
    summary = Summary(data_end=start)
    for record in walk(file, start, end):
        summary.note(record.opcode, read_body(file, record))
    return summary


def _scanned(file: IO[bytes], end: int) -> Summary:
    """Find attachments and metadata of a file that has no summary."""
    summary = Summary(data_end=end)
    for record in walk(file, len(MAGIC), end):
        if record.opcode == Opcode.ATTACHMENT:
            summary.attachments.append(record.start)
        elif record.opcode == Opcode.METADATA:
            summary.metadata.append(record.start)
    return summary


def _crc(file: IO[bytes], start: int, end: int) -> int:
    file.seek(start)
    crc = 0
    for block in _blocks(file, end - start):
        crc = zlib.crc32(block, crc)
    return crc


def _blocks(file: IO[bytes], length: int) -> Iterator[bytes]:
    while length > 0 and (block := file.read(min(length, _BLOCK))):
        length -= len(block)
        yield block
