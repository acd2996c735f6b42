"""ROS messages in MCAP files, of ROS 2 or ROS 1, with or without index, chunks or profile."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mcap import records
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.channels import Account, BagMessage, Channel, Wanted, ros2_name
from slam.logs.mcap_read import Log
from slam.logs.mcap_summary import open_file, read_summary

_ENCODINGS = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1"}


class McapBag:
    """One MCAP file."""

    kind = "ROS bag"

    def __init__(self, path: Path) -> None:
        self._path = path

    def messages(self, wanted: Wanted, account: Account) -> Iterator[BagMessage]:
        """Yield the wanted messages in file order."""
        known: dict[int, Channel] = {}
        with open_mcap(self._path) as log:
            for raw in log.raw_messages():
                channel = known.get(raw.channel_id)
                if channel is None:
                    described = log.described(raw.channel_id)
                    if described is None:
                        account.skipped["messages of a channel that is nowhere described"] += 1
                        continue
                    channel = known[raw.channel_id] = channel_of(*described)
                account.counts[channel] += 1
                if wanted(channel):
                    yield BagMessage(channel, raw.log_time, raw.data)
            account.skipped.update(log.skipped)


def open_mcap(path: Path) -> Log:
    """Open an MCAP file of any content.

    Raises:
        TruncatedLog: it was cut off.
        LogError: it is no MCAP file.
    """
    file = open_file(path)
    try:
        return Log(path, file, read_summary(file, path))
    except BaseException:
        file.close()
        raise


def channel_of(channel: records.Channel, schema: records.Schema | None) -> Channel:
    """Return what an MCAP channel is to us.

    The encoding is the channel's; where that is empty, the one that its schema goes with.
    """
    language = schema.encoding if schema else ""
    encoding = channel.message_encoding or _ENCODINGS.get(language, "")
    text = schema.data.decode("utf-8", "replace") if schema and language in _ENCODINGS else ""
    return Channel(
        channel.topic,
        ros2_name(schema.name) if schema else "",
        encoding,
        text,
        language,
        language or encoding,
    )


def require_ros(path: Path, channels: list[Channel]) -> None:
    """Refuse a file in which nothing was serialised by ROS.

    Raises:
        LogError: it holds none of ROS's messages.
    """
    if channels and not any(channel.is_ros for channel in channels):
        found = ", ".join(f"{shown(c.topic)} ({shown(c.kind or c.where or '?')})" for c in channels)
        raise LogError(f"{path}: holds no ROS messages, only {found[:400]}: nothing to import")
