"""Opening a log: whatever is not one of ours, or newer than this program, is refused."""

from __future__ import annotations

from pathlib import Path

from slam.logs.errors import LogError, NewerSchema, shown
from slam.logs.mcap_read import Log
from slam.logs.mcap_summary import open_file, read_summary
from slam.logs.schemas import CHANNELS

SCHEMA_VERSION = 1
"""Version of channels and fields; raised when an old reader would misread a new file."""


def open_log(path: Path | str) -> Log:
    """Open an MCAP log for reading; use it in a `with` block.

    Raises:
        TruncatedLog: if the recording was cut off.
        NewerSchema: if a newer version of this program wrote it.
        LogError: if it is no MCAP log, or has no channel of ours.
    """
    path = Path(path)
    file = open_file(path)
    try:
        log = Log(path, file, read_summary(file, path))
        _require_known_version(log)
        _require_our_channels(log)
    except BaseException:
        file.close()
        raise
    return log


def _require_known_version(log: Log) -> None:
    stated = log.metadata().get("run", {}).get("schema_version")
    if stated is None:
        return
    if not (stated.isascii() and stated.isdigit() and len(stated) < 10):
        raise LogError(f"{log.path}: schema version {shown(stated)!r} is not a number")
    if int(stated) > SCHEMA_VERSION:
        raise NewerSchema(
            f"{log.path}: written by a newer version (schema {int(stated)}, this one reads up to "
            f"{SCHEMA_VERSION}): upgrade with `pip install --upgrade sdp-slam`"
        )


def _require_our_channels(log: Log) -> None:
    channels = log.channels() if log.has_summary else _channels_met(log)
    if channels and not any(is_ours(topic, schema) for topic, schema in channels.items()):
        found = ", ".join(f"{shown(t)} ({shown(s) or 'no schema'})" for t, s in channels.items())
        raise LogError(
            f"{log.path}: has none of our channels, only {found[:400]}: "
            "ROS bags become logs with `slam import`"
        )


def _channels_met(log: Log) -> dict[str, str]:
    """Return the channels of a file without a summary, up to the first of ours.

    Only the chunks up to it are read; what is damaged there is counted when it is read again.
    """
    known = 0
    for _ in log.raw_messages():
        channels = log.channel_ids()
        if len(channels) > known:
            known = len(channels)
            if any(is_ours(*channel) for channel in channels.values()):
                break
    log.skipped.clear()
    return log.channels()


def is_ours(topic: str, schema_name: str) -> bool:
    """Whether a channel is one of ours, in topic and schema."""
    return topic in CHANNELS and CHANNELS[topic].schema_name == schema_name
