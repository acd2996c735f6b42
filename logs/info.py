"""What a log holds and what it lost, read in one pass without keeping messages."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from slam.logs.mcap_open import open_log
from slam.logs.mcap_read import Log
from slam.logs.messages import LogLine
from slam.logs.schemas import CHANNELS, STAMP_LIMIT, decode
from slam.logs.timing import Timing, TimingCounter


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """One topic of a log."""

    topic: str
    schema: str  # empty for raw bytes
    known: bool  # whether it is a channel of ours, which replay reads
    bytes: int  # of payload, unpacked
    timing: Timing


@dataclass(frozen=True, slots=True)
class AttachmentInfo:
    """A file inside the log."""

    name: str
    media_type: str
    bytes: int


_LINES = 20  # of those on `/log`, the last
_LONGEST = 4096  # bytes of a line


@dataclass(frozen=True, slots=True)
class LogInfo:
    """A log at a glance.  Text in it comes from the file: show it through `errors.shown`."""

    path: str
    bytes: int
    first_received_ns: int  # 0 if there are no messages
    last_received_ns: int
    channels: tuple[ChannelInfo, ...]  # by topic
    run: dict[str, str]  # the run's identity
    metadata: dict[str, dict[str, str]]  # every other metadata record
    attachments: tuple[AttachmentInfo, ...]
    lines: tuple[LogLine, ...]  # the last that were said on `/log`
    lost_recording: dict[str, int]  # dropped or refused while recording, per cause
    lost_reading: dict[str, int]  # damaged or malformed, per cause

    @property
    def messages(self) -> int:
        """Messages on all channels."""
        return sum(channel.timing.messages for channel in self.channels)

    @property
    def duration_s(self) -> float:
        """From the first receipt to the last."""
        return (self.last_received_ns - self.first_received_ns) * 1e-9

    @property
    def lost(self) -> bool:
        """Whether anything was lost, recording or reading."""
        return bool(self.lost_recording or self.lost_reading)


def read_info(path: Path | str) -> LogInfo:
    """Read a log once and return what it holds; payloads are not decoded but for `/log`.

    Raises:
        LogError: if it cannot be opened as one of our logs.
    """
    path = Path(path)
    with open_log(path) as log:
        timings: dict[int, TimingCounter] = {}
        sizes: Counter[int] = Counter()
        talk: set[int] = set()  # the channels `/log`
        said: deque[tuple[int, bytes]] = deque(maxlen=_LINES)  # stamp and payload
        first, last = STAMP_LIMIT, 0
        for raw in log.raw_messages():
            if raw.publish_time >= STAMP_LIMIT or raw.log_time >= STAMP_LIMIT:
                log.skipped["time after the year 2262"] += 1
                continue
            if raw.channel_id not in timings:
                timings[raw.channel_id] = TimingCounter()
                if log.channel_ids().get(raw.channel_id, ("",))[0] == "/log":
                    talk.add(raw.channel_id)
            timings[raw.channel_id].add(raw.publish_time)
            sizes[raw.channel_id] += len(raw.data)
            if raw.channel_id in talk and len(raw.data) <= _LONGEST:
                said.append((raw.publish_time, raw.data))
            first, last = min(first, raw.log_time), max(last, raw.log_time)
        for number in timings.keys() - log.channel_ids().keys():
            cause = "messages of a channel that is nowhere described"
            log.skipped[cause] += timings[number].count
        metadata = log.metadata()
        attachments = [AttachmentInfo(a.name, a.media_type, len(a.data)) for a in log.attachments()]
        return LogInfo(
            str(path),
            path.stat().st_size,
            first if timings else 0,
            last,
            _channels(log, timings, sizes),
            metadata.pop("run", {}),
            metadata,
            tuple(attachments),
            _lines(said),
            recording_losses(metadata),
            dict(log.skipped),
        )


def _lines(said: Iterable[tuple[int, bytes]]) -> tuple[LogLine, ...]:
    """Decode what was said; a line that cannot be read is replay's to count."""
    lines = []
    for stamp_ns, data in said:
        with suppress(ValueError):
            line = decode("/log", stamp_ns, data)
            assert isinstance(line, LogLine)
            lines.append(line)
    return tuple(lines)


def recording_losses(metadata: dict[str, dict[str, str]]) -> dict[str, int]:
    """Return what the recorder noted of messages it could not write, and `recover` of bytes."""
    noted = metadata.get("recording", {})
    losses = {cause: int(n) for cause, n in noted.items() if _is_count(n)}
    lost_bytes = metadata.get("recovered", {}).get("lost_bytes", "0")
    if _is_count(lost_bytes) and int(lost_bytes) > 0:
        losses["bytes that `slam recover` could not read"] = int(lost_bytes)
    return losses


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 19


def _channels(
    log: Log, timings: dict[int, TimingCounter], sizes: Counter[int]
) -> tuple[ChannelInfo, ...]:
    listed = []
    for number, (topic, schema) in log.channel_ids().items():
        timing = timings.get(number, TimingCounter()).result()
        ours = topic in CHANNELS and CHANNELS[topic].schema_name == schema
        listed.append(ChannelInfo(topic, schema, ours, sizes[number], timing))
    return tuple(sorted(listed, key=lambda channel: channel.topic))
