"""Coverage-guided fuzzing of the log reader, by `make fuzz`; needs atheris."""

import os
import sys
import tempfile
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parents[2]))
with atheris.instrument_imports(include=["logs"]):
    from tests.logs.reader_oracle import plain_log, read_every_way

SEEDS = [plain_log(chunked, summary) for chunked in (True, False) for summary in (True, False)]
os.fsync = lambda _: None  # the disk need not keep these files
FILE = Path(tempfile.mkdtemp()) / "a.mcap"


def one_input(data: bytes) -> None:
    """Lay the input over a sound log: which one, and where, its first bytes say."""
    if len(data) < 4:
        return
    whole = bytearray(SEEDS[data[0] % len(SEEDS)])
    at = 8 + int.from_bytes(data[1:4], "little") % (len(whole) - 8)
    whole[at : at + len(data) - 4] = data[4:]
    FILE.write_bytes(whole)
    read_every_way(FILE)


atheris.Setup(sys.argv, one_input)
atheris.Fuzz()
