"""A campaign's drives, written down as each ends, so that it can go on after an interruption."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from slam.drivers.simulators.faults import FaultKind

Case = tuple[str, int, FaultKind | None]  # building, seed, fault


class DriveBook:
    """Drives that are done, a line of JSON each, under a first line that tells what they are of.

    A file of another program or configuration is begun anew.
    """

    def __init__(self, path: Path, what: dict[str, Any]) -> None:
        self.path = path
        self.runs: dict[Case, dict[str, Any]] = {}
        first = json.dumps(what) + "\n"
        lines = path.read_text(encoding="utf-8").splitlines(True) if path.exists() else []
        kept = [line for line in lines[1:] if line.endswith("\n")] if first in lines[:1] else []
        for line in kept:
            run = json.loads(line)
            self.runs[_case(run)] = run
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(first + "".join(kept), encoding="utf-8")  # without a line cut short

    def add(self, case: Case, run: dict[str, Any]) -> None:
        """Write down a drive."""
        self.runs[case] = run
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(run) + "\n")


def program_sha256() -> str:
    """Hash of the program's source text: figures of two programs must not be mixed."""
    root = Path(__file__).parents[1]
    packages = ("backend", "benchmarks", "drivers", "frontend", "logs", "slam")
    files = sorted(path for package in packages for path in (root / package).rglob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _case(run: dict[str, Any]) -> Case:
    fault = None if run["fault"] == "none" else run["fault"]
    return run["building"], run["seed"], fault
