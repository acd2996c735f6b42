"""A closed log written again in larger chunks.

While recording, a chunk ends with every sync, twice a second, so that little is lost; such
small chunks compress badly.  Nothing is decoded here and no message changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.writer import Writer
from slam.logs.errors import LogError
from slam.logs.mcap_file import MAGIC, PARSE_ERRORS, Damaged, read_body, walk
from slam.logs.mcap_summary import Summary, open_file, read_summary
from slam.logs.mcap_writer import new_writer
from slam.logs.partial import PartialFile
from slam.logs.record_copy import COPIED, RecordCopier

LARGE_CHUNK_BYTES = 1 << 20
"""Larger ones gain less than 1 % and cost a reader memory and time to seek."""


@dataclass(frozen=True, slots=True)
class Recompression:
    """What it brought."""

    path: Path
    bytes_before: int
    bytes_after: int


def recompress(path: Path | str) -> Recompression:
    """Replace a closed log by the same log in larger chunks.

    The new file takes the old one's name only when it is complete and on the disk.

    Raises:
        LogError: if the log is damaged (it is left as it is) or there is no room.
    """
    path = Path(path)
    before = path.stat().st_size if path.exists() else 0
    with open_file(path) as file:
        summary = read_summary(file, path)
        out = PartialFile(path, keep=False, suffix=".recompressing")
        try:
            _copy(file, summary, new_writer(out.stream, LARGE_CHUNK_BYTES))
            out.commit()
        except OSError as error:
            out.abandon()
            raise LogError(f"{path}: recompression failed: {error.strerror}") from error
        except (Damaged, *PARSE_ERRORS) as error:
            out.abandon()
            raise LogError(f"{path}: not recompressed: {error}: run `slam recover`") from error
        except BaseException:
            out.abandon()
            raise
    return Recompression(path, before, path.stat().st_size)


def _copy(file: IO[bytes], summary: Summary, writer: Writer) -> None:
    copier = RecordCopier(writer)
    for record in walk(file, len(MAGIC), summary.data_end):
        if record.opcode == Opcode.DATA_END:
            break
        if record.opcode in COPIED:
            copier.copy(record.opcode, read_body(file, record))
    counted = summary.statistics.message_count if summary.statistics else copier.counts.total()
    if counted != copier.counts.total():
        raise Damaged("messages that its index counts are gone")
    writer.finish()  # type: ignore[no-untyped-call]
