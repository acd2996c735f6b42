"""How a recording shall go, and how it went."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class RecorderConfig:
    """How to record; 0 switches a rotation off."""

    queue_messages: int = 8192  # about ten seconds at ten times the usual rate
    rotate_bytes: int = 0  # a new file after this many bytes
    rotate_s: float = 0.0  # or after this long
    reserve_bytes: int = 256 * 2**20  # recording stops when less is free on the disk
    recompress: bool = True  # at a clean close; takes seconds for an hour of recording


@dataclass(frozen=True, slots=True)
class RecordingStatus:
    """What has become of the messages so far."""

    files: tuple[Path, ...]  # complete ones, in order
    written: int  # messages
    dropped: dict[str, int]  # per topic: the queue was full
    refused: dict[str, int]  # per topic: could not be encoded, or recording had stopped
    queued: int  # messages that wait now
    queued_most: int
    slowest_sync_s: float
    stopped: str  # why recording stopped before its end; empty if it did not

    @property
    def lost(self) -> int:
        """How many messages were given and not written, without those that still wait."""
        return sum(self.dropped.values()) + sum(self.refused.values())
