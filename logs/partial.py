"""Files that appear under their name only when they are complete."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO

from slam.logs.errors import LogError
from slam.logs.file_lock import hold, is_held


class PartialFile:
    """A file written as `NAME.partial` and renamed to `NAME` by `commit`.

    With `keep`, what was written before a failure stays under the partial name, and an
    older one is never overwritten: it may be the only copy of a recording.  Such a file is
    locked while it is written, so that others can tell a recording from what one has left.
    """

    def __init__(self, path: Path, keep: bool, suffix: str = ".partial") -> None:
        """Open `NAME.partial`, or with another suffix where that name may be the source's.

        Raises:
            LogError: if it cannot be created, or is there already and `keep` is set.
        """
        self.path = path
        self.partial = path.with_name(path.name + suffix)
        self.keep = keep
        if path.is_dir():
            raise LogError(f"{path}: is a folder: name a file to write")
        try:
            self.stream: IO[bytes] = self.partial.open("xb" if keep else "wb")
        except FileExistsError as error:
            if is_held(self.partial):
                raise LogError(
                    f"{self.partial}: another program is recording to it: choose another name"
                ) from error
            raise LogError(
                f"{self.partial}: an unfinished recording is in the way: run "
                f"`slam recover {self.partial} --out FILE`, then remove it"
            ) from error
        except OSError as error:
            raise LogError(
                f"{path}: cannot be written: {error.strerror}: choose another place for it"
            ) from error
        if keep:
            hold(self.stream.fileno())

    def sync(self) -> None:
        """Bring everything written so far to the disk (OSError if it will not go)."""
        self.stream.flush()
        os.fsync(self.stream.fileno())

    def commit(self) -> None:
        """Sync, close and give the file its name, replacing an older one."""
        self.sync()
        self.stream.close()
        os.replace(self.partial, self.path)
        self._sync_folder()

    def abandon(self) -> None:
        """Close without renaming; the partial file stays if it is to be kept."""
        with suppress(OSError):  # the disk is full already; what is on it stays
            self.sync()
        with suppress(OSError):
            self.stream.close()
        if not self.keep:
            self.partial.unlink(missing_ok=True)

    def _sync_folder(self) -> None:
        """Make the new name survive a power cut, where the system lets folders be synced."""
        with suppress(OSError):
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
