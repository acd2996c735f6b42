"""Results of long campaigns, kept as they are made, so that a campaign can be gone on with."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError

Row = dict[str, Any]


class KeptRuns:
    """A file with one result a line; those of another program or configuration do not count."""

    def __init__(self, path: Path, config: SlamConfig | None = None) -> None:
        """Read what is there; a line that was cut off is made again."""
        self._path = path
        self._made_by = f"{program_sha256()} {(config or SlamConfig()).sha256()}"
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

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def __getitem__(self, name: str) -> Row:
        return self._rows[name]

    def add(self, name: str, row: Row) -> None:
        """Keep the row of a run.

        Raises:
            RunError: the file cannot be written.
        """
        kept = {"run": name, "made_by": self._made_by, "row": row}
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(self._before + json.dumps(kept) + "\n")
            self._before = ""
        except OSError as error:
            raise RunError(f"{self._path}: cannot be written: {error.strerror}") from error
        self._rows[name] = row

    def made(self, name: str, make: Callable[[], Row]) -> Row:
        """Return the row of a run, made now if it is not there yet.

        Raises:
            RunError: the file cannot be written.
        """
        if name not in self:
            self.add(name, make())
        return self[name]


def program_sha256() -> str:
    """Hash of the program's source text: figures of two programs must not be mixed."""
    root = Path(__file__).parents[1]
    packages = ("backend", "benchmarks", "drivers", "frontend", "logs", "slam")
    files = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
