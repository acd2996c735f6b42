"""The files of one recording: one after the other, each of use without the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from slam.logs.attachments import Attachment
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, Message


@dataclass(frozen=True, slots=True)
class RotationConfig:
    """When to begin a new file; 0 means never."""

    bytes: int = 0
    seconds: float = 0.0

    @property
    def on(self) -> bool:
        """Whether there may be more than one file."""
        return self.bytes > 0 or self.seconds > 0


@dataclass(frozen=True, slots=True)
class Note:
    """A metadata record."""

    name: str
    values: dict[str, str]


class PartWriter:
    """Writes messages to a log, and to the next one when that is large or old enough.

    Every file gets the metadata and attachments that came before, and the laser's mount,
    which is sent only once.  Not for use from several threads.
    """

    def __init__(
        self,
        path: Path,
        run: Mapping[str, str],
        rotation: RotationConfig,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.files: list[Path] = []  # complete ones
        self.written = 0  # messages, in all files; the repeated mounts are not counted
        self.slowest_sync_s = 0.0
        self._path, self._run, self._rotation, self._clock = path, dict(run), rotation, clock
        self._fresh: list[Path] = []
        self._notes: dict[str, dict[str, str]] = {}
        self._attachments: dict[str, Attachment] = {}
        self._extrinsics: tuple[LaserExtrinsics, int | None] | None = None
        self._part = 0
        self._log = self._open()

    def write(self, message: Message, receipt_ns: int | None) -> bool:
        """Write a message and return whether it could be encoded.

        Raises:
            LogError: if the disk fails; the file is closed as it is then.
        """
        if self._due():
            self._rotate()
        if isinstance(message, LaserExtrinsics):
            self._extrinsics = message, receipt_ns
        try:
            self._log.write(message, receipt_ns)
        except LogError:
            if self._log.closed:
                raise
            return False
        self.written += 1
        return True

    def add(self, extra: Note | Attachment) -> None:
        """Write metadata or an attachment into this file and those after it."""
        if isinstance(extra, Note):
            self._notes.setdefault(extra.name, {}).update(extra.values)
            self._log.add_metadata(extra.name, extra.values)
        else:
            self._attachments[extra.name] = extra
            self._log.add_attachment(extra.name, extra.data, extra.media_type)

    def tick(self) -> None:
        """Sync if it is due."""
        self._log.tick()

    def close(self) -> None:
        """Complete the current file."""
        self.slowest_sync_s = max(self.slowest_sync_s, self._log.slowest_sync_s)
        self._log.close()
        self.files.append(self._log.path)
        self._fresh.append(self._log.path)

    def abandon(self) -> None:
        """Leave the current file as it is, for `slam recover`."""
        self._log.abandon()

    def take_fresh(self) -> list[Path]:
        """Return the files completed since this was last called."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def _due(self) -> bool:
        limit, seconds = self._rotation.bytes, self._rotation.seconds
        return (limit > 0 and self._log.bytes_written >= limit) or (
            seconds > 0 and self._clock() - self._opened_at >= seconds
        )

    def _rotate(self) -> None:
        self.close()
        self._part += 1
        self._log = self._open()
        for name, values in self._notes.items():
            self._log.add_metadata(name, values)
        for kept in self._attachments.values():
            self._log.add_attachment(kept.name, kept.data, kept.media_type)
        if self._extrinsics is not None:
            self._log.write(*self._extrinsics)

    def _open(self) -> LogWriter:
        path, run = self._path, self._run
        if self._rotation.on:
            path = path.with_name(f"{path.stem}_{self._part:03}{path.suffix}")
            run = run | {"part": str(self._part)}
        if path.exists():
            raise LogError(f"{path}: is there already: a recording never replaces another")
        self._opened_at = self._clock()
        return LogWriter(path, run, clock=self._clock)
