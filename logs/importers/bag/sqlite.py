"""ROS 2 bags in sqlite files (`.db3`), by their tables."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import zstandard
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.channels import Account, BagMessage, Channel, Wanted

MAGIC = b"SQLite format 3\0"
MESSAGE_LIMIT = 256 << 20  # bytes of one message, packed or not
# ValueError: words of the file in the messages of sqlite's own errors are no text.
_DAMAGE = (sqlite3.Error, ValueError, OverflowError, MemoryError)
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # of messages that the recorder compressed one by one


class SqliteBag:
    """One file of a ROS 2 bag in sqlite."""

    kind = "ROS bag"

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, wanted: Wanted, account: Account) -> Iterator[BagMessage]:
        """Yield the wanted messages in the order in which they were written."""
        try:
            with closing(self._open()) as database:
                channels = self._channels(database)
                yield from self._rows(database, channels, wanted, account)
        except _DAMAGE as error:
            raise LogError(
                f"{self._path}: cannot be read as a ROS bag: {shown(str(error))}"
            ) from error

    def _open(self) -> sqlite3.Connection:
        # A recorder that was cut off leaves its last messages in a file beside; that can only
        # be taken in where sqlite may write, so it is tried first.
        beside = self._path.with_name(self._path.name + "-wal").exists()
        last: Exception | None = None
        for how in ("mode=ro", "immutable=1") if beside else ("immutable=1",):
            database = sqlite3.connect(f"file:{quote(str(self._path))}?{how}", uri=True)
            database.text_factory = lambda raw: raw.decode("utf-8", "replace")
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_LIMIT)
            try:
                database.execute("SELECT id FROM topics LIMIT 1").fetchall()
            except _DAMAGE as error:
                database.close()
                last = error
                continue
            return database
        assert last is not None
        raise last

    def _channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        definitions: dict[str, tuple[str, str]] = {}
        try:
            rows = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {str(kind): (str(form), str(text)) for kind, form, text in rows}
        except _DAMAGE:
            pass  # recorders before Iron had no such table
        channels = {}
        rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
        for number, topic, kind, encoding in rows:
            form, text = definitions.get(str(kind), ("", ""))
            channels[number] = Channel(str(topic), str(kind), str(encoding), text, form)
        return channels

    def _rows(
        self,
        database: sqlite3.Connection,
        channels: dict[int, Channel],
        wanted: Wanted,
        account: Account,
    ) -> Iterator[BagMessage]:
        ids = [number for number, channel in channels.items() if wanted(channel)]
        rows = database.execute(
            "SELECT topic_id, timestamp, CASE WHEN topic_id IN "
            f"({','.join('?' * len(ids))}) THEN data END FROM messages",
            ids,
        )
        while True:
            try:
                row = rows.fetchone()
            except _DAMAGE:
                account.skipped["rest of the bag: it is damaged or cut off"] += 1
                return
            if row is None:
                return
            channel = channels.get(row[0])
            if channel is None:
                account.skipped["messages of a topic that is nowhere described"] += 1
                continue
            account.counts[channel] += 1
            if wanted(channel):
                data = _payload(row[2])
                if data is None or not isinstance(row[1], int):
                    account.skipped[f"{shown(channel.topic)}: malformed message"] += 1
                else:
                    yield BagMessage(channel, row[1], data)


def _payload(data: Any) -> bytes | None:
    if not isinstance(data, bytes):
        return None
    if data[:4] != _ZSTD_MAGIC:  # the first bytes of CDR are 0, 1, 0, 0 or 0, 0, 0, 0
        return data
    try:
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=MESSAGE_LIMIT)
    except zstandard.ZstdError:
        return None
