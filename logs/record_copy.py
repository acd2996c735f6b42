"""Records of one MCAP file copied into another, with channels and schemas renumbered."""

from __future__ import annotations

from collections import Counter

from mcap import records
from mcap.opcode import Opcode
from mcap.writer import Writer
from slam.logs.mcap_chunk import Inner, RawMessage, inner_records, message_of, unpack_chunk
from slam.logs.mcap_file import Damaged, attachment_of, stream

COPIED = {
    Opcode.CHUNK,
    Opcode.MESSAGE,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
}
"""The kinds of record that carry content; the others are indexes, which a writer makes anew."""


class RecordCopier:
    """Copies record after record to a writer, and counts what it copied."""

    def __init__(self, writer: Writer) -> None:
        self.counts: Counter[str] = Counter()  # messages per topic
        self.times: tuple[int, int] | None = None  # ns, first and last log time
        self.attachments = 0
        self.metadata = 0
        self._writer = writer
        self._schema_ids: dict[int, int] = {0: 0}  # old id to new
        self._channel_ids: dict[int, int] = {}
        self._topics: dict[int, str] = {}  # by new id

    @property
    def nothing(self) -> bool:
        """Whether no record of substance was copied."""
        return not (self.counts or self.attachments or self.metadata)

    def copy(self, opcode: int, body: bytes) -> None:
        """Copy one record; those that are not `COPIED` are passed over.

        Raises:
            Damaged: if it is not what the format says; part of a chunk may be copied then.
            One of `PARSE_ERRORS`: likewise.
        """
        if opcode == Opcode.CHUNK:
            self.copy_inner(unpack_chunk(body))
        elif opcode == Opcode.MESSAGE:
            self._copy_message(message_of(body, 0, len(body)))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(Inner(opcode, body))
        elif opcode == Opcode.ATTACHMENT:
            self._copy_attachment(body)
        elif opcode == Opcode.METADATA:
            metadata = records.Metadata.read(stream(body))
            self._writer.add_metadata(metadata.name, metadata.metadata)
            self.metadata += 1

    def copy_inner(self, data: bytes) -> None:
        """Copy the records of an unpacked chunk."""
        for inner in inner_records(data):
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
        self.counts[self._topics[channel_id]] += 1
        first, last = self.times or (message.log_time, message.log_time)
        self.times = min(first, message.log_time), max(last, message.log_time)

    def _copy_attachment(self, body: bytes) -> None:
        attachment = attachment_of(body)
        self._writer.add_attachment(
            attachment.create_time,
            attachment.log_time,
            attachment.name,
            attachment.media_type,
            attachment.data,
        )
        self.attachments += 1
