"""`slam import`: a foreign log becomes an MCAP log."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserScan


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What was imported, what was repaired, and what could not be used."""

    kind: str
    messages: int
    scans: int
    changed: Counter[str]
    skipped: Counter[str]
    ignored: Counter[str]  # sound, but of no use here
    notes: list[str] = field(default_factory=list)  # what was chosen
    warnings: list[str] = field(default_factory=list)  # what of it was a guess


_NO_WISHES = Wishes()


def import_log(file: Path, out: Path, wishes: Wishes = _NO_WISHES) -> ImportReport:
    """Read a foreign log of any supported kind and write it as MCAP.

    Raises:
        LogError: it cannot be read, or not without an answer in `wishes`; or the log cannot be
            written or would replace it.
    """
    if out.exists() and os.path.samefile(file, out):
        raise LogError(f"{out}: is the log to be imported itself: name another file to write")
    imported = read_any(file, wishes)
    identity = {"source": file.name, "imported_from": imported.kind}
    with LogWriter(out, identity, keep_partial=False) as log:
        messages = scans = 0
        for message, receipt_ns in imported.received():
            log.write(message, receipt_ns)
            messages += 1
            scans += isinstance(message, LaserScan)
        counts = {**imported.skipped, **imported.changed, **imported.ignored}
        said = {f"chosen {n}": text for n, text in enumerate(imported.notes, start=1)}
        said |= {f"guessed {n}": text for n, text in enumerate(imported.warnings, start=1)}
        log.add_metadata("import", {**{c: str(count) for c, count in counts.items()}, **said})
    return ImportReport(
        imported.kind, messages, scans, imported.changed, imported.skipped, imported.ignored,
        imported.notes, imported.warnings,
    )  # fmt: skip
