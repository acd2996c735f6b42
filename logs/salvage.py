"""One pass over a damaged file that copies what is intact."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.writer import Writer
from slam.logs.errors import LogError
from slam.logs.mcap_chunk import chunk_header, unpack_cut_chunk
from slam.logs.mcap_file import (
    MAGIC,
    PARSE_ERRORS,
    RECORD_HEADER,
    RECORD_LIMIT,
    Damaged,
    Record,
    read_body,
    walk,
)
from slam.logs.mcap_summary import read_summary
from slam.logs.record_copy import COPIED, RecordCopier

_PROBLEMS_DESCRIBED = 1000  # of a file made to hurt; beyond it they are only counted
_HEAD = RECORD_HEADER.size + 64  # bytes: enough for the header of a chunk


class Salvage:
    """Copies the intact records of a file to a writer, and keeps account of the others."""

    def __init__(self, path: Path, file: IO[bytes], writer: Writer) -> None:
        self.copied = RecordCopier(writer)
        self._described: list[str] = []
        self._undescribed = 0
        self.lost_bytes = 0
        self.unchecked = 0  # messages out of a chunk that was cut off
        self.closed_well = False
        self._path, self._file, self._writer = path, file, writer
        self._size = os.fstat(file.fileno()).st_size

    @property
    def problems(self) -> tuple[str, ...]:
        """What was lost, piece by piece."""
        more = (f"and {self._undescribed} more",) if self._undescribed else ()
        return (*self._described, *more)

    def run(self) -> None:
        """Copy record after record until the data ends or the next one cannot be found."""
        at = len(MAGIC)
        try:
            for record in walk(self._file, at, self._size):
                if record.opcode == Opcode.DATA_END:
                    self._compare_with_index()
                    return
                self._copy(record)
                at = record.end
        except Damaged as error:
            saved = self._copy_cut_chunk(at)
            note = f"; its first {saved} messages are saved, unchecked" if saved else ""
            self._lose(at, self._size, f"{error}{self._time_lost(at)}{note}")

    def _compare_with_index(self) -> None:
        """Take note of messages that the file's own index counts and nobody found."""
        with suppress(LogError):
            statistics = read_summary(self._file, self._path).statistics
            self.closed_well = True
            missing = statistics.message_count - self.copied.counts.total() if statistics else 0
            if missing > 0:
                self._describe(f"{missing} of the messages that the index counts are gone")

    def _copy(self, record: Record) -> None:
        if record.opcode not in COPIED:
            return
        try:
            self.copied.copy(record.opcode, read_body(self._file, record))
        except (Damaged, *PARSE_ERRORS) as error:
            self._lose(record.start, record.end, f"{error}{self._time_lost(record.start)}")

    def _copy_cut_chunk(self, at: int) -> int:
        """Copy what can be unpacked of a chunk that the file's end cuts off."""
        before = self.copied.counts.total()
        self._file.seek(at)
        head = self._file.read(RECORD_HEADER.size)
        with suppress(Damaged, *PARSE_ERRORS):
            opcode, length = RECORD_HEADER.unpack(head)
            if opcode == Opcode.CHUNK and length <= RECORD_LIMIT:
                rest = self._file.read(length)
                self.copied.copy_inner(unpack_cut_chunk(rest, length))
        self.unchecked = self.copied.counts.total() - before
        return self.unchecked

    def _lose(self, start: int, end: int, cause: str) -> None:
        self.lost_bytes += end - start
        self._describe(f"{end - start} bytes at {start}: {cause}")

    def _describe(self, problem: str) -> None:
        if len(self._described) < _PROBLEMS_DESCRIBED:
            self._described.append(problem)
        else:
            self._undescribed += 1

    def _time_lost(self, start: int) -> str:
        """Say from when the lost chunk was, if enough of it is there to tell."""
        self._file.seek(start)
        head = self._file.read(_HEAD)
        with suppress(Damaged):
            if head[:1] == bytes([Opcode.CHUNK]):
                chunk = chunk_header(head[RECORD_HEADER.size :])
                return f" (messages received from {chunk.start_ns} to {chunk.end_ns} ns)"
        return ""

    def finish(self) -> None:
        """Note in the new log what it is, and write its index."""
        note = {"source": self._path.name, "lost_bytes": str(self.lost_bytes)}
        self._writer.add_metadata("recovered", note | {"problems": "; ".join(self.problems[:20])})
        self._writer.finish()  # type: ignore[no-untyped-call]
