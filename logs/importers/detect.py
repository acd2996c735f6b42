"""Any supported foreign log, told apart by its first lines rather than by its name."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path

from logs.errors import LogError
from logs.importers.breezyslam import FIELDS, read_breezyslam
from logs.importers.carmen import KINDS, read_carmen
from logs.importers.imported import ImportedLog
from logs.importers.text_lines import lines
from logs.mcap_file import MAGIC

SUPPORTED = "CARMEN (.clf, .log) and BreezySLAM (.dat) logs, plain or gzipped"

_LINES_LOOKED_AT = 2000  # CARMEN logs may begin with hundreds of PARAM lines or comments


def read_any(path: Path | str) -> ImportedLog:
    """Read a foreign log of any kind that is supported.

    Raises:
        LogError: if the file cannot be read, is of no such kind, or is our own already.
    """
    path = Path(path)
    for line in islice(lines(path, Counter()), _LINES_LOOKED_AT):
        if line.startswith(MAGIC[:6]):
            raise LogError(f"{path}: is an MCAP log already: use it with `slam replay`")
        fields = line.split(maxsplit=FIELDS)
        if not fields or fields[0].startswith(b"#"):
            continue
        if fields[0] in KINDS:
            return read_carmen(path)
        if len(fields) == FIELDS and fields[0].isdigit():
            return read_breezyslam(path)
    raise LogError(f"{path}: is no log of a known kind: {SUPPORTED} can be imported")
