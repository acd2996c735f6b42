"""Saving what is intact of a log that was cut off or damaged."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap import records
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from logs.errors import LogError
from logs.mcap_file import (
    MAGIC,
    PARSE_ERRORS,
    Damaged,
    Inner,
    RawMessage,
    Record,
    attachment_of,
    chunk_times,
    inner_records,
    message_of,
    read_body,
    stream,
    unpack_chunk,
    walk,
)
from logs.mcap_log import CHUNK_BYTES, library_name
from logs.mcap_summary import open_file, read_summary
from logs.partial import PartialFile


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What was saved and what was not.

    `problems` describes each piece that could not be read, in file order; a file that only
    lacked its end, with every record before that intact, has none but `unclosed`.
    """

    messages: dict[str, int]  # saved, per topic
    attachments: int
    metadata: int
    first_ns: int  # log time of the first saved message, 0 if there is none
    last_ns: int
    unclosed: bool  # the file had no proper end
    lost_bytes: int  # bytes of records that could not be read
    problems: tuple[str, ...]

    @property
    def lost(self) -> bool:
        """Whether anything that the file held could not be saved."""
        return bool(self.problems)


def recover(source: Path | str, target: Path | str) -> RecoveryReport:
    """Copy every intact record of `source`, ours or not, to a new log with an index.

    A message is saved if its whole chunk is there and fits its checksum.

    Raises:
        LogError: if the source is no MCAP file, holds no intact message, attachment or
            metadata, or the target cannot be written.
    """
    source, target = Path(source), Path(target)
    with open_file(source) as file:
        if target.exists() and os.path.samefile(source, target):
            raise LogError(f"{target}: is the damaged log itself: name another file to write")
        out = PartialFile(target, keep=False)
        try:
            salvage = _Salvage(source, file, _new_writer(out.stream))
            salvage.run()
            if salvage.nothing:
                raise LogError(f"{source}: holds nothing that is intact: it cannot be recovered")
            salvage.finish()
            out.commit()
        except OSError as error:
            out.abandon()
            raise LogError(f"{target}: writing failed: {error.strerror}") from error
        except BaseException:
            out.abandon()
            raise
    return salvage.report()


def _new_writer(stream: IO[bytes]) -> Writer:
    writer = Writer(
        stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
    )
    writer.start(profile="", library=library_name())
    return writer


class _Salvage:
    """One pass over a damaged file, copying records to a writer."""

    def __init__(self, path: Path, file: IO[bytes], writer: Writer) -> None:
        self._path, self._file, self._writer = path, file, writer
        self._size = os.fstat(file.fileno()).st_size
        self._schema_ids: dict[int, int] = {0: 0}  # old id to new
        self._channel_ids: dict[int, int] = {}
        self._topics: dict[int, str] = {}  # by new id
        self._counts: Counter[str] = Counter()
        self._times: tuple[int, int] | None = None
        self._attachments = self._metadata = self._lost_bytes = 0
        self._problems: list[str] = []
        self._closed_well = False

    @property
    def nothing(self) -> bool:
        """Whether no record of substance was intact."""
        return not (self._counts or self._attachments or self._metadata)

    def run(self) -> None:
        """Copy record after record until the data ends or the next one cannot be found."""
        at = len(MAGIC)
        try:
            for record in walk(self._file, at, self._size):
                if record.opcode == Opcode.DATA_END:
                    self._compare_with_index()
                    return
                self._copy(record)
                at = record.end
        except Damaged as error:
            self._lose(at, self._size, str(error))

    def _compare_with_index(self) -> None:
        """Take note of messages that the file's own index counts and nobody found."""
        with suppress(LogError):
            statistics = read_summary(self._file, self._path).statistics
            self._closed_well = True
            missing = statistics.message_count - self._counts.total() if statistics else 0
            if missing > 0:
                self._problems.append(f"{missing} of the messages that the index counts are gone")

    def _copy(self, record: Record) -> None:
        try:
            body = read_body(self._file, record) if record.opcode in _COPIED else b""
            if record.opcode == Opcode.CHUNK:
                self._copy_chunk(body)
            elif record.opcode == Opcode.MESSAGE:
                self._copy_message(message_of(body, 0, len(body)))
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(Inner(record.opcode, body))
            elif record.opcode == Opcode.ATTACHMENT:
                self._copy_attachment(body)
            elif record.opcode == Opcode.METADATA:
                metadata = records.Metadata.read(stream(body))
                self._writer.add_metadata(metadata.name, metadata.metadata)
                self._metadata += 1
        except (Damaged, *PARSE_ERRORS) as error:
            self._lose(record.start, record.end, str(error))

    def _copy_chunk(self, body: bytes) -> None:
        for inner in inner_records(unpack_chunk(body)):
            if isinstance(inner, Inner):
                self._define(inner)
            else:
                self._copy_message(inner)

    def _define(self, inner: Inner) -> None:
        if inner.opcode == Opcode.SCHEMA:
            schema = records.Schema.read(stream(inner.body))
            if schema.id not in self._schema_ids:
                self._schema_ids[schema.id] = self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            return
        channel = records.Channel.read(stream(inner.body))
        if channel.id in self._channel_ids:
            return
        if channel.schema_id not in self._schema_ids:
            raise Damaged("a channel's schema is missing")
        new_id = self._writer.register_channel(
            channel.topic,
            channel.message_encoding,
            self._schema_ids[channel.schema_id],
            channel.metadata,
        )
        self._channel_ids[channel.id], self._topics[new_id] = new_id, channel.topic

    def _copy_message(self, message: RawMessage) -> None:
        if message.channel_id not in self._channel_ids:
            raise Damaged("messages of a channel that is nowhere described")
        channel_id = self._channel_ids[message.channel_id]
        self._writer.add_message(
            channel_id, message.log_time, message.data, message.publish_time, message.sequence
        )
        self._counts[self._topics[channel_id]] += 1
        first, last = self._times or (message.log_time, message.log_time)
        self._times = min(first, message.log_time), max(last, message.log_time)

    def _copy_attachment(self, body: bytes) -> None:
        attachment = attachment_of(body)
        self._writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
        self._attachments += 1

    def _lose(self, start: int, end: int, cause: str) -> None:
        self._lost_bytes += end - start
        self._problems.append(f"{end - start} bytes at {start}: {cause}{self._time_lost(start)}")

    def _time_lost(self, start: int) -> str:
        """Say from when the lost chunk was, if enough of it is there to tell."""
        self._file.seek(start)
        head = self._file.read(9 + 64)
        with suppress(Damaged):
            if head[:1] == bytes([Opcode.CHUNK]):
                first, last = chunk_times(head[9:])
                return f" (messages received from {first} to {last} ns)"
        return ""

    def finish(self) -> None:
        """Note in the new log what it is, and write its index."""
        note = {"source": self._path.name, "lost_bytes": str(self._lost_bytes)}
        self._writer.add_metadata("recovered", note | {"problems": "; ".join(self._problems[:20])})
        self._writer.finish()  # type: ignore[no-untyped-call]

    def report(self) -> RecoveryReport:
        first, last = self._times or (0, 0)
        return RecoveryReport(
            dict(self._counts),
            self._attachments,
            self._metadata,
            first,
            last,
            not self._closed_well,
            self._lost_bytes,
            tuple(self._problems),
        )


_COPIED = {
    Opcode.CHUNK,
    Opcode.MESSAGE,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
}
