"""Results of a campaign, written down as each comes in, so that it can go on later."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class ResultBook:
    """A line of JSON for each result, under a first line that tells what they are of.

    A file of another program or configuration is begun anew; a line cut short is forgotten.
    """

    def __init__(self, path: Path, what: dict[str, Any], key: Sequence[str]) -> None:
        """Read what is there; `key` names the fields that tell one result from another."""
        self.path, self._key = path, tuple(key)
        self.results: dict[tuple[Any, ...], dict[str, Any]] = {}
        first = json.dumps(what, sort_keys=True) + "\n"
        lines = path.read_text(encoding="utf-8").splitlines(True) if path.exists() else []
        kept = [line for line in lines[1:] if line.endswith("\n")] if first in lines[:1] else []
        for line in kept:
            self._put(json.loads(line))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(first + "".join(kept), encoding="utf-8")

    def _put(self, result: dict[str, Any]) -> None:
        self.results[tuple(result[field] for field in self._key)] = result

    def add(self, result: dict[str, Any]) -> None:
        """Write down a result."""
        self._put(result)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
