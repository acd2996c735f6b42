"""Messages as tables: a folder with one CSV file for each topic.

The first two columns are the stamp and the time of receipt in ns, the others the message's
fields under their own names; lists, such as a scan's ranges, are one cell with spaces
between the numbers, raw bytes are hexadecimal.  Maps are left out: a picture holds them.
"""

from __future__ import annotations

import csv
import io
import shutil
from collections import Counter
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import numpy as np
from slam.logs.errors import LogError
from slam.logs.messages import Message, OccupancyMap
from slam.logs.schemas import topic_of

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def write_csv(path: Path | str, received: Iterable[tuple[int | None, Message]]) -> dict[str, int]:
    """Write the tables and return the number of rows by file name.

    `Log.receipts()` gives messages in this form.  The folder appears when it is complete.

    Raises:
        LogError: if the folder is there already, cannot be written, or would be empty.
    """
    path = Path(path)
    if path.exists():
        raise LogError(f"{path}: is there already: name a new folder")
    partial = path.with_name(path.name + ".partial")
    tables = _Tables(partial)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        for receipt_ns, message in received:
            if not isinstance(message, OccupancyMap):
                tables.add(receipt_ns, message)
        tables.close()
        if not tables.rows:
            raise LogError(f"{path}: there is no message to write")
        partial.rename(path)
    except OSError as error:
        raise LogError(f"{path}: writing failed: {error.strerror}") from error
    finally:
        tables.close()
        shutil.rmtree(partial, ignore_errors=True)
    return dict(tables.rows)


class _Tables:
    """Open files, one a topic."""

    def __init__(self, folder: Path) -> None:
        self.rows: Counter[str] = Counter()
        self._folder = folder
        self._files: dict[str, IO[str]] = {}

    def add(self, receipt_ns: int | None, message: Message) -> None:
        """Write one row."""
        name = topic_of(message).strip("/").replace("/", "_") + ".csv"
        names = [field.name for field in fields(message) if field.name != "stamp_ns"]
        if name not in self._files:
            self._files[name] = (self._folder / name).open("w", encoding="utf-8", newline="")
            self._files[name].write(_line(["stamp_ns", "receipt_ns", *names]))
        receipt = message.stamp_ns if receipt_ns is None else receipt_ns
        cells = [_cell(getattr(message, n)) for n in names]
        self._files[name].write(_line([str(message.stamp_ns), str(receipt), *cells]))
        self.rows[name] += 1

    def close(self) -> None:
        """Close all files."""
        for file in self._files.values():
            file.close()


def _line(cells: list[str]) -> str:
    line = io.StringIO()
    csv.writer(line).writerow(cells)
    return line.getvalue()


def _cell(value: Any) -> str:
    """Write numbers so that they read back exactly, and text so that no program runs it."""
    if isinstance(value, np.ndarray):
        return " ".join(map(str, value))
    if isinstance(value, tuple):
        return " ".join(map(repr, value))
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, str):
        return "'" + value if value.startswith(_FORMULA_STARTS) else value
    return repr(value)
