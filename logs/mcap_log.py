"""Our MCAP logs: `LogWriter` writes messages, `open_log` reads them back in file order.

Log time is the time of receipt, publish time the stamp.  The metadata record `run` carries
the schema version; a file of a newer version is refused rather than misread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from slam.logs import protos
from slam.logs.attachments import Attachment, check_attachment
from slam.logs.errors import LogError
from slam.logs.mcap_open import SCHEMA_VERSION, open_log
from slam.logs.mcap_read import Log
from slam.logs.mcap_writer import CHUNK_BYTES, library_name, new_writer
from slam.logs.messages import Message
from slam.logs.partial import PartialFile
from slam.logs.schemas import CHANNELS, STAMP_LIMIT, Channel, topic_of

__all__ = ["SCHEMA_VERSION", "Attachment", "Log", "LogWriter", "library_name", "open_log"]

SYNC_PERIOD_S = 0.5
"""Half of the second that may be lost, so that a slow disk has the other half."""


class LogWriter:
    """Writes messages to an MCAP file; use it in a `with` block.

    The file is `NAME.partial` until the block ends well.  After an exception the partial
    file stays for `slam recover`, unless `keep_partial` is False (for files that can be
    made again).  Not for use from several threads.

    Args:
        path: where the log shall be.
        run: the run's identity, written to the metadata record `run`.
        clock: seconds, monotonic; decides when to sync.
        sync_period_s: data reaches the disk after at most this long, as long as `write` or
            `tick` is called.
        keep_partial: whether an unfinished file is worth keeping.

    Raises:
        LogError: if the file cannot be created.
    """

    def __init__(
        self,
        path: Path | str,
        run: Mapping[str, str] | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        sync_period_s: float = SYNC_PERIOD_S,
        keep_partial: bool = True,
    ) -> None:
        self.path = Path(path)
        self._file = PartialFile(self.path, keep_partial)
        self._clock, self._sync_period_s = clock, sync_period_s
        self._channel_ids: dict[str, int] = {}
        self._schema_ids: dict[str, int] = {"": 0}
        self._sequences: dict[str, int] = {}
        self._last_receipt_ns = 0
        self._closed = False
        self.slowest_sync_s = 0.0
        with self._disk():
            self._writer = new_writer(self._file.stream, CHUNK_BYTES)
            self._writer.add_metadata("run", {**(run or {}), "schema_version": str(SCHEMA_VERSION)})
            self._sync()

    def write(self, message: Message, receipt_ns: int | None = None) -> None:
        """Append a message, received at `receipt_ns` (its stamp if not given).

        Raises:
            LogError: if the message cannot be written exactly, or the disk fails.
        """
        topic = topic_of(message)
        channel = CHANNELS[topic]
        receipt = message.stamp_ns if receipt_ns is None else receipt_ns
        if not (0 <= message.stamp_ns < STAMP_LIMIT and 0 <= receipt < STAMP_LIMIT):
            raise LogError(
                f"{self.path}: {topic}: stamp {message.stamp_ns} ns, received {receipt} ns: "
                "a log holds times from 1970 to 2262 only"
            )
        try:
            data = channel.encode(message)
        except ValueError as error:
            raise LogError(f"{self.path}: {topic}: cannot be written: {error}") from error
        with self._disk():
            sequence = self._sequences.get(topic, 0)
            channel_id = self._channel_ids.get(topic) or self._register(channel)
            self._writer.add_message(channel_id, receipt, data, message.stamp_ns, sequence)
            self._sequences[topic] = (sequence + 1) % 2**32
            self._last_receipt_ns = receipt
        self.tick()

    def tick(self) -> None:
        """Sync if it is due; call this when no message comes for a while."""
        if not self._closed and self._clock() - self._synced_at >= self._sync_period_s:
            self.sync()

    def sync(self) -> None:
        """Finish the chunk and bring it to the disk.

        Raises:
            LogError: if the disk fails; the log is closed then.
        """
        with self._disk():
            self._sync()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record; readers merge records of one name, later values win."""
        with self._disk():
            self._writer.add_metadata(name, dict(values))

    def add_attachment(self, name: str, data: bytes, media_type: str) -> None:
        """Attach a file under a plain name, without folders.

        Raises:
            LogError: if the name is not plain, the data too large, or the disk fails.
        """
        check_attachment(self.path, name, data)
        at = self._last_receipt_ns
        with self._disk():
            self._writer.add_attachment(at, at, name, media_type, data)

    @property
    def closed(self) -> bool:
        """Whether the log takes no more, be it finished or because the disk failed."""
        return self._closed

    @property
    def bytes_written(self) -> int:
        """Size of the file so far, without the chunk in progress."""
        return 0 if self._closed else self._file.stream.tell()

    def close(self) -> None:
        """Write the index and give the file its name.

        Raises:
            LogError: if the disk fails; what was written stays under the partial name.
        """
        if self._closed:
            return
        with self._disk():
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.commit()
            self._closed = True

    def abandon(self) -> None:
        """Close without finishing: what came so far stays in the partial file, if kept."""
        if not self._closed:
            self._closed = True
            self._file.abandon()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        """Turn a failing disk into a LogError, with the file closed as it is."""
        if self._closed:
            raise LogError(f"{self.path}: the log is closed, nothing more can be written to it")
        try:
            yield
        except OSError as error:
            self.abandon()
            rest = f"what was written is in {self._file.partial.name} (`slam recover`)"
            raise LogError(
                f"{self.path}: writing failed: {error.strerror}: free some space or choose "
                f"another disk{'; ' + rest if self._file.keep else ''}"
            ) from error

    def _register(self, channel: Channel) -> int:
        if channel.schema_name not in self._schema_ids:
            self._schema_ids[channel.schema_name] = self._writer.register_schema(
                channel.schema_name, "protobuf", protos.descriptor_set(channel.message)
            )
        channel_id = self._writer.register_channel(
            channel.topic, channel.encoding, self._schema_ids[channel.schema_name]
        )
        self._channel_ids[channel.topic] = channel_id
        return channel_id

    def _sync(self) -> None:
        began = self._clock()
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.sync()
        self._synced_at = began  # not its end: a slow disk must not stretch the period
        self.slowest_sync_s = max(self.slowest_sync_s, self._clock() - began)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
            return
        if not self._closed:
            with suppress(OSError):  # the exception in flight is the one to report
                self._sync()
            self.abandon()
