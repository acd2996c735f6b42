"""Files that are there whole or not at all, whoever else writes them too."""

from __future__ import annotations

import os
import uuid
from pathlib import Path


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write a file under another name and rename it when it is complete.

    Several processes may write the same file, so each uses a partial name of its own.

    Raises:
        OSError: it cannot be written; `filename` names the file that was asked for.
    """
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    data = content.encode() if isinstance(content, str) else content
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
