"""Reading our MCAP logs: messages in file order, streamed chunk by chunk.

Not by the readers of the `mcap` package, for two reasons.  They stop at the first damage, where
this one counts what is lost and goes on.  And they make an object of every record: of closed logs
they give 83 000 (SeekingReader) and 88 000 (StreamReader) undecoded messages a second of CPU with
181 beams, this one 194 000; with 1081 beams 42 000 and 37 000 against 63 000.  With decoding it is
47 000 and 56 000 against 90 000, and 25 000 and 22 000 against 30 000.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap import records
from mcap.opcode import Opcode
from slam.logs.attachments import Attachment, is_plain_name
from slam.logs.foxglove import ForViewersError
from slam.logs.mcap_chunk import Inner, RawMessage, inner_records, message_of, unpack_chunk
from slam.logs.mcap_file import (
    MAGIC,
    PARSE_ERRORS,
    Damaged,
    Record,
    attachment_of,
    indexed_messages,
    read_body,
    stream,
    walk,
)
from slam.logs.mcap_summary import Summary
from slam.logs.messages import Message
from slam.logs.schemas import CHANNELS, STAMP_LIMIT, decode


class Log:
    """An open log.  `skipped` counts per cause what could not be read, and grows as it is read."""

    def __init__(self, path: Path, file: IO[bytes], summary: Summary) -> None:
        self.path = path
        self.skipped: Counter[str] = Counter()
        self._file, self._summary = file, summary

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the messages on the given topics (all of ours) in file order."""
        for _, message in self.receipts(topics):
            yield message

    def receipts(self, topics: Collection[str] | None = None) -> Iterator[tuple[int, Message]]:
        """Yield each message with its time of receipt in ns, in file order."""
        wanted = CHANNELS.keys() if topics is None else CHANNELS.keys() & set(topics)
        topic_of_id: dict[int, str | None] = {}
        for raw in self.raw_messages():
            if raw.channel_id not in topic_of_id:
                topic_of_id[raw.channel_id] = self._topic(raw.channel_id)
            topic = topic_of_id[raw.channel_id]
            if topic is None or topic not in wanted:
                continue
            if raw.publish_time >= STAMP_LIMIT or raw.log_time >= STAMP_LIMIT:
                self.skipped[f"{topic}: time after the year 2262"] += 1
                continue
            try:
                message = decode(topic, raw.publish_time, raw.data)
            except ForViewersError:
                continue
            except ValueError as error:
                self.skipped[f"{topic}: {error}"] += 1
                continue
            yield raw.log_time, message

    def _topic(self, channel_id: int) -> str | None:
        """Return the topic of a channel, if it is one of ours in topic and schema."""
        channel = self._summary.channels.get(channel_id)
        if channel is None:
            self.skipped["messages of a channel that is nowhere described"] += 1
            return None
        ours = CHANNELS.get(channel.topic)
        schema = self._summary.schemas.get(channel.schema_id)
        fits = ours is not None and (schema.name if schema else "") == ours.schema_name
        return channel.topic if fits else None

    def raw_messages(self) -> Iterator[RawMessage]:
        """Yield the messages of all channels, undecoded, in file order; damage is counted."""
        seen = 0
        for record in self._records():
            try:
                if record.opcode == Opcode.CHUNK:
                    for raw in self._inside(unpack_chunk(read_body(self._file, record))):
                        seen += 1
                        yield raw
                elif record.opcode == Opcode.MESSAGE:
                    body = read_body(self._file, record)
                    seen += 1
                    yield message_of(body, 0, len(body))
                elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._summary.note(record.opcode, read_body(self._file, record))
            except (Damaged, *PARSE_ERRORS) as error:
                lost = self._indexed_after(record)
                seen += lost
                cause = error if isinstance(error, Damaged) else "a record is malformed"
                self.skipped[f"messages lost: {cause}"] += lost
        statistics = self._summary.statistics
        if statistics is not None and statistics.message_count > seen:
            missing = statistics.message_count - seen
            self.skipped["messages lost: counted in the index, not found"] += missing

    def _indexed_after(self, chunk: Record) -> int:
        """Return how many messages the indexes behind a damaged chunk count, at least 1."""
        count = 0
        with suppress(Damaged):
            for record in walk(self._file, chunk.end, self._summary.data_end):
                if record.opcode != Opcode.MESSAGE_INDEX:
                    break
                count += indexed_messages(read_body(self._file, record))
        return max(count, 1)

    def _inside(self, data: bytes) -> Iterator[RawMessage]:
        for inner in inner_records(data):
            if isinstance(inner, Inner):
                self._summary.note(inner.opcode, inner.body)
            else:
                yield inner

    def _records(self) -> Iterator[Record]:
        try:
            for record in walk(self._file, len(MAGIC), self._summary.data_end):
                if record.opcode == Opcode.DATA_END:
                    return
                yield record
        except Damaged as error:
            self.skipped[f"rest of the file: {error}"] += 1

    def channels(self) -> dict[str, str]:
        """Return every topic in the file, ours or not, with the name of its schema.

        In a file without a summary, only channels met so far are known.
        """
        return dict(self.channel_ids().values())

    def channel_ids(self) -> dict[int, tuple[str, str]]:
        """Return topic and schema name of every channel known so far, by its number."""
        schemas = self._summary.schemas
        return {
            channel.id: (
                channel.topic,
                schemas[channel.schema_id].name if channel.schema_id in schemas else "",
            )
            for channel in self._summary.channels.values()
        }

    def described(self, channel_id: int) -> tuple[records.Channel, records.Schema | None] | None:
        """Return a channel as the file describes it, with its schema; None if it does not."""
        channel = self._summary.channels.get(channel_id)
        if channel is None:
            return None
        return channel, self._summary.schemas.get(channel.schema_id)

    @property
    def has_summary(self) -> bool:
        """Whether the file lists its channels at its end; some programs leave that out."""
        return self._summary.statistics is not None or bool(self._summary.channels)

    def counts(self) -> dict[str, int]:
        """Return the number of messages per topic, as the file states it or by reading it."""
        statistics = self._summary.statistics
        by_id: Counter[int] = Counter()
        if statistics is not None:
            by_id.update(statistics.channel_message_counts)
        else:
            by_id.update(raw.channel_id for raw in self.raw_messages())
        counts: Counter[str] = Counter()
        for channel_id, channel in sorted(self._summary.channels.items()):
            counts[channel.topic] += by_id[channel_id]
        return dict(counts)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records; those of one name are merged, later values win."""
        merged: dict[str, dict[str, str]] = {}
        for body in self._bodies(self._summary.metadata, Opcode.METADATA):
            try:
                record = records.Metadata.read(stream(body))
            except PARSE_ERRORS:
                self.skipped["metadata record is malformed"] += 1
                continue
            merged.setdefault(record.name, {}).update(record.metadata)
        return merged

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attached files; one whose name is not a plain file name is skipped."""
        for body in self._bodies(self._summary.attachments, Opcode.ATTACHMENT):
            try:
                record = attachment_of(body)
            except Damaged as error:
                self.skipped[str(error)] += 1
                continue
            if is_plain_name(record.name):
                yield Attachment(record.name, record.media_type, record.data)
            else:
                self.skipped["attachment with an unsafe name"] += 1

    def _bodies(self, offsets: list[int], opcode: Opcode) -> Iterator[bytes]:
        for offset in offsets:
            try:
                record = next(walk(self._file, offset, self._summary.data_end))
                if record.opcode != opcode:
                    raise Damaged("the index points to something else")
                yield read_body(self._file, record)
            except (Damaged, StopIteration) as error:
                self.skipped[f"{opcode.name.lower()} not found: {error}"] += 1

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
