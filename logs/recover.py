"""Saving what is intact of a log that was cut off or damaged."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.file_lock import is_held
from slam.logs.mcap_summary import open_file, read_header
from slam.logs.mcap_writer import CHUNK_BYTES, new_writer
from slam.logs.partial import PartialFile
from slam.logs.salvage import Salvage


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What was saved and what was not.

    `problems` describes each piece that could not be read, in file order; a file that only
    lacked its end, with every record before that intact, has none but `unclosed`.
    """

    messages: dict[str, int]  # saved, per topic
    attachments: int
    metadata: int
    first_ns: int  # log time of the first saved message, 0 if there is none
    last_ns: int
    unclosed: bool  # the file had no proper end
    lost_bytes: int  # bytes of records that could not be read
    problems: tuple[str, ...]
    unchecked: int = 0  # messages saved from a chunk whose end, with its checksum's rest, is gone

    @property
    def lost(self) -> bool:
        """Whether anything that the file held could not be saved."""
        return bool(self.problems)


def recover(source: Path | str, target: Path | str) -> RecoveryReport:
    """Copy every intact record of `source`, ours or not, to a new log with an index.

    A message is saved if its whole chunk is there and fits its checksum.  Of a chunk that
    the file's end cuts off, the messages that can still be unpacked are saved as well and
    counted as `unchecked`.  The copy keeps the source's profile and library, by which other
    programs tell what is in it.

    Raises:
        LogError: if the source is no MCAP file, holds no intact message, attachment or
            metadata, is still being recorded, or the target cannot be written.
    """
    source, target = Path(source), Path(target)
    if is_held(source):
        raise LogError(
            f"{source}: is still being recorded: stop that program first (Ctrl-C ends "
            "`slam online` in good order, and then there is nothing to recover)"
        )
    with open_file(source) as file:
        if target.exists() and os.path.samefile(source, target):
            raise LogError(f"{target}: is the damaged log itself: name another file to write")
        out = PartialFile(target, keep=False, suffix=".recovering")
        try:
            writer = new_writer(out.stream, CHUNK_BYTES, *read_header(file))
            salvage = Salvage(source, file, writer)
            salvage.run()
            if salvage.copied.nothing:
                raise LogError(f"{source}: holds nothing that is intact: it cannot be recovered")
            salvage.finish()
            out.commit()
        except OSError as error:
            out.abandon()
            raise LogError(f"{target}: writing failed: {error.strerror}") from error
        except BaseException:
            out.abandon()
            raise
    return _report(salvage)


def _report(salvage: Salvage) -> RecoveryReport:
    copied = salvage.copied
    first, last = copied.times or (0, 0)
    return RecoveryReport(
        dict(copied.counts),
        copied.attachments,
        copied.metadata,
        first,
        last,
        not salvage.closed_well,
        salvage.lost_bytes,
        salvage.problems,
        salvage.unchecked,
    )
