"""Recording in a thread of its own, so that a slow disk never holds up the sensors.

`Recorder.put` never waits: a message goes into a bounded queue or is dropped and counted.
The thread brings everything to the disk twice a second, starts a new file when the old one
is large or old enough, and stops with a reason, not with an error, when the disk runs full.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from slam.logs.attachments import Attachment, check_attachment
from slam.logs.errors import LogError
from slam.logs.messages import Message
from slam.logs.part_writer import Note, PartWriter, RotationConfig
from slam.logs.recompress import recompress
from slam.logs.recording import RecorderConfig, RecordingStatus
from slam.logs.schemas import topic_of

_TICK_S = 0.1  # how long the thread sleeps at most; with half a second to a sync: below one
_BATCH = 256  # messages written between two looks at the clock and the disk
_LOOK_S = 0.5  # between two looks at the free space
_CALM = 2.0  # recompression needs the file's size this often, beside the reserve


_Item = tuple[Message, int | None] | Note | Attachment


def _free_bytes(folder: Path) -> int:
    return shutil.disk_usage(folder).free


class Recorder:
    """Records messages from any thread; use it in a `with` block.

    Args:
        path: the log; with rotation the files are `NAME_000.mcap`, `NAME_001.mcap`, ...
        run: the run's identity, written to the metadata record `run` of every file.
        config: queue, rotation, reserve.
        clock: seconds, monotonic.
        free_bytes: how much room is left on a folder's disk.

    Raises:
        LogError: if the first file cannot be created.
    """

    def __init__(
        self,
        path: Path | str,
        run: Mapping[str, str] | None = None,
        config: RecorderConfig | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
        free_bytes: Callable[[Path], int] = _free_bytes,
    ) -> None:
        self.path = Path(path)
        self.config = config or RecorderConfig()
        self._clock, self._free_bytes = clock, free_bytes
        self._queue: deque[_Item] = deque()
        self._in_hand: deque[_Item] = deque()  # the thread's own
        self._changed = threading.Condition()
        self._dropped: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._dropped_noted = 0
        self._most = 0
        self._stopped, self._closing = "", False
        self._failure: BaseException | None = None
        self._looked_at = clock()
        rotation = RotationConfig(self.config.rotate_bytes, self.config.rotate_s)
        self._parts = PartWriter(self.path, run or {}, rotation, clock)
        self._thread = threading.Thread(target=self._run, name=f"record {self.path.name}")
        self._thread.start()

    def put(self, message: Message, receipt_ns: int | None = None) -> bool:
        """Take a message to be written and return whether it was taken; never waits.

        `receipt_ns` is when its bytes were read (its stamp if not given).
        """
        topic = topic_of(message)
        with self._changed:
            if self._stopped or self._closing:
                self._refused[topic] += 1
                return False
            if len(self._queue) >= self.config.queue_messages:
                self._dropped[topic] += 1
                return False
            self._queue.append((message, receipt_ns))
            self._most = max(self._most, len(self._queue))
            self._changed.notify()
        return True

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record (device identity, clock model, ...) to this and later files."""
        self._put_extra(Note(name, dict(values)))

    def add_attachment(self, name: str, data: bytes, media_type: str) -> None:
        """Attach a file (config, calibration, ...) to this and later log files.

        Raises:
            LogError: if the name is not plain or the data too large.
        """
        check_attachment(self.path, name, data)
        self._put_extra(Attachment(name, media_type, data))

    def _put_extra(self, extra: Note | Attachment) -> None:
        with self._changed:
            if not (self._stopped or self._closing):
                self._queue.append(extra)
                self._changed.notify()

    def status(self) -> RecordingStatus:
        """Return how the recording stands."""
        with self._changed:
            return RecordingStatus(
                tuple(self._parts.files),
                self._parts.written,
                dict(self._dropped),
                dict(self._refused),
                len(self._queue),
                self._most,
                self._parts.slowest_sync_s,
                self._stopped,
            )

    def close(self, *, recompress: bool | None = None) -> RecordingStatus:
        """Write what still waits, close the file, recompress, and say what was recorded.

        A file that cannot be recompressed stays as it was recorded.
        """
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        if self._failure is not None:  # a defect, not the disk: it belongs to the caller
            raise self._failure
        if self.config.recompress if recompress is None else recompress:
            self._recompress()
        return self.status()

    def _recompress(self) -> None:
        for path in self._parts.take_fresh():
            room = self._free_bytes(path.parent) - self.config.reserve_bytes
            if room > _CALM * path.stat().st_size:
                try:
                    recompress(path)
                except LogError:
                    continue  # the log itself is whole, and larger than it need be

    def _run(self) -> None:
        try:
            while self._take_in_hand():
                while self._in_hand:
                    self._write(self._in_hand[0])
                    self._in_hand.popleft()
                self._look_after()
            if not self._stopped:
                self._note_losses()
                self._parts.close()
        except LogError as error:
            self._stop(str(error))
        except BaseException as error:  # handed to the caller by `close`
            self._failure = error
            self._parts.abandon()
            self._stop(f"{self.path}: recording failed: {error!r}")

    def _take_in_hand(self) -> bool:
        """Wait for messages or the next tick; return False at the end."""
        with self._changed:
            if not self._queue and not self._closing:
                self._changed.wait(_TICK_S)
            if self._stopped or (self._closing and not self._queue):
                return False
            taken = min(len(self._queue), _BATCH)
            self._in_hand.extend(self._queue.popleft() for _ in range(taken))
        return True

    def _write(self, item: _Item) -> None:
        if not isinstance(item, tuple):
            self._parts.add(item)
        elif not self._parts.write(*item):
            with self._changed:
                self._refused[topic_of(item[0])] += 1

    def _look_after(self) -> None:
        """Sync if due, note what was dropped, and watch the room that is left."""
        self._parts.tick()
        now = self._clock()
        if now - self._looked_at < _LOOK_S:
            return
        self._looked_at = now
        self._note_losses()
        free = self._free_bytes(self.path.parent)
        if free < self.config.reserve_bytes:
            self._parts.close()
            self._stop(
                f"{self.path}: recording stopped: only {free >> 20} MiB are free on the disk, "
                f"{self.config.reserve_bytes >> 20} MiB are kept in reserve: free some space"
            )

    def _note_losses(self) -> None:
        """Write what was dropped into the log itself, where `slam info` finds it."""
        with self._changed:
            dropped, refused = dict(self._dropped), dict(self._refused)
        total = sum(dropped.values()) + sum(refused.values())
        if total > self._dropped_noted:
            self._dropped_noted = total
            values = {f"dropped {topic}": str(n) for topic, n in dropped.items()}
            values |= {f"refused {topic}": str(n) for topic, n in refused.items()}
            self._parts.add(Note("recording", values))

    def _stop(self, reason: str) -> None:
        with self._changed:
            self._stopped = reason
            for item in (*self._in_hand, *self._queue):
                if isinstance(item, tuple):
                    self._refused[topic_of(item[0])] += 1
            self._queue.clear()
            self._in_hand.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close(recompress=None if kind is None else False)
