"""Files that are there whole or not at all, whoever else writes them too."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write a file under another name and rename it when it is complete.

    Raises:
        OSError: it cannot be written; `filename` names the file that was asked for.
    """
    with atomic_path(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give another name to write a file under; it gets its own if the block ends well.

    Several processes may write the same file, so each uses a partial name of its own.

    Raises:
        OSError: it cannot be written; `filename` names the file that was asked for.
    """
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    try:
        yield partial
        os.replace(partial, path)
    except BaseException as error:
        with suppress(OSError):  # the first error is the one to report
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
