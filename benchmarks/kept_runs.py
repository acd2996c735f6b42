"""Results of long campaigns, kept as they are made, so that a campaign can be gone on with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError
from slam.runs.run_directory import version

Row = dict[str, Any]


class KeptRuns:
    """A file with one result a line; those of another version or configuration do not count."""

    def __init__(self, path: Path) -> None:
        """Read what is there; a line that was cut off is made again."""
        self._path = path
        self._made_by = f"{version()} {SlamConfig().sha256()}"
        self._rows: dict[str, Row] = {}
        text = path.read_text("utf-8") if path.exists() else ""
        self._before = "" if text.endswith("\n") or not text else "\n"  # ends a line cut off
        for line in text.splitlines():
            try:
                kept = json.loads(line)
                if kept["made_by"] == self._made_by:
                    self._rows[kept["run"]] = kept["row"]
            except (ValueError, KeyError, TypeError):
                continue

    def made(self, name: str, make: Callable[[], Row]) -> Row:
        """Return the row of a run, made now if it is not there yet.

        Raises:
            RunError: the file cannot be written.
        """
        if name not in self._rows:
            row = make()
            kept = {"run": name, "made_by": self._made_by, "row": row}
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                with self._path.open("a", encoding="utf-8") as file:
                    file.write(self._before + json.dumps(kept) + "\n")
                self._before = ""
            except OSError as error:
                raise RunError(f"{self._path}: cannot be written: {error.strerror}") from error
            self._rows[name] = row
        return self._rows[name]
