"""Lines of a text log, plain or gzipped, whatever is wrong with the file."""

from __future__ import annotations

import gzip
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import IO

from slam.logs.errors import LogError

LINE_LIMIT = 1 << 20
"""Longest line that is read (bytes): 40 times a scan of 1081 beams with 17 digits each."""

_GZIP_MAGIC = b"\x1f\x8b"


def open_text(path: Path) -> IO[bytes]:
    """Open a text log for reading bytes, unpacking gzip.

    Raises:
        LogError: if there is nothing to read.
    """
    if path.is_dir():
        raise LogError(f"{path}: is a folder, not a log: name a file in it")
    try:
        file = path.open("rb")
    except FileNotFoundError as error:
        raise LogError(f"{path}: there is no such file: check the name") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    start = file.read(2)
    file.seek(0)
    if start == _GZIP_MAGIC:
        file.close()
        return gzip.open(path)  # type: ignore[return-value]
    if not start:
        file.close()
        raise LogError(f"{path}: is empty: nothing to import")
    return file


def lines(path: Path, skipped: Counter[str]) -> Iterator[bytes]:
    """Yield the lines of a log; a damaged end and endless lines are counted and left out.

    Raises:
        LogError: if the file cannot be read at all.
    """
    with closing(open_text(path)) as file:
        while True:
            try:
                line = file.readline(LINE_LIMIT)
            except (EOFError, zlib.error, gzip.BadGzipFile):
                skipped["rest of the file: gzip data is damaged or cut off"] += 1
                return
            except OSError as error:
                raise LogError(f"{path}: cannot be read: {error.strerror}") from error
            if not line:
                return
            if len(line) == LINE_LIMIT and not line.endswith(b"\n"):
                skipped["lines too long"] += 1
                while line and not line.endswith(b"\n"):
                    line = file.readline(LINE_LIMIT)
                continue
            yield line
