"""Files that are there whole or not at all, whoever else writes them too."""

from __future__ import annotations

import os
import uuid
from pathlib import Path

from slam.errors import RunError


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file and give it its name when it is complete.

    Several processes may write the same one, so each has a partial name of its own.

    Raises:
        RunError: it cannot be written.
    """
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}.partial")
    data = content.encode() if isinstance(content, str) else content
    try:
        partial.write_bytes(data)
        os.replace(partial, path)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise RunError(f"{path}: cannot be written: {error.strerror or error}") from error
        raise
