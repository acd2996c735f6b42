"""Any supported foreign log, told apart by what it begins with rather than by its name."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.importers import g2o_scans
from slam.logs.importers.breezyslam import FIELDS, read_breezyslam
from slam.logs.importers.carmen import KINDS, read_carmen
from slam.logs.importers.g2o_scans import read_g2o_scans
from slam.logs.importers.imported import ImportedLog, StreamedLog
from slam.logs.importers.rosbag import read_rosbag
from slam.logs.importers.text_lines import lines
from slam.logs.mcap_file import MAGIC

SUPPORTED = (
    "CARMEN (.clf, .log) and BreezySLAM (.dat) logs, plain or gzipped, ROS 1 bags, ROS 2 bags "
    "(folder, .mcap, .db3), and g2o graphs with ROBOTLASER1 lines (plain, .gz, .zip)"
)

_LINES_LOOKED_AT = 2000  # CARMEN logs may begin with hundreds of PARAM lines or comments
_BAG_MAGICS = (b"#ROSBAG V", b"SQLite format 3\0")
_ROS_PROFILES = (b"ros2", b"ros1")
_PROFILE_AT = len(MAGIC) + 9  # behind the opcode and length of the header record


def read_any(path: Path | str) -> ImportedLog | StreamedLog:
    """Read a foreign log of any kind that is supported.

    Raises:
        LogError: if the file cannot be read, is of no such kind, or is our own already.
    """
    path = Path(path)
    if path.is_dir() and (path / "metadata.yaml").is_file():
        return read_rosbag(path)
    start = _start_of(path)
    if start.startswith(_BAG_MAGICS):
        return read_rosbag(path)
    if start.startswith(MAGIC[:6]):
        if start[_PROFILE_AT + 4 : _PROFILE_AT + 8] in _ROS_PROFILES:
            return read_rosbag(path)
        raise LogError(f"{path}: is an MCAP log already: use it with `slam replay`")
    if start.startswith(g2o_scans.ZIP_MAGIC):
        return read_g2o_scans(path)
    return _read_text(path)


def _start_of(path: Path) -> bytes:
    """Return the first bytes, none if the file cannot be read: `lines` says why."""
    try:
        with path.open("rb") as file:
            return file.read(64)
    except OSError:
        return b""


def _read_text(path: Path) -> ImportedLog:
    for line in islice(lines(path, Counter()), _LINES_LOOKED_AT):
        fields = line.split(maxsplit=FIELDS)
        if not fields or fields[0].startswith(b"#"):
            continue
        if fields[0] in g2o_scans.KINDS:
            return read_g2o_scans(path)
        if fields[0] in KINDS:
            return read_carmen(path)
        if len(fields) == FIELDS and fields[0].isdigit():
            return read_breezyslam(path)
    raise LogError(f"{path}: is no log of a known kind: {SUPPORTED} can be imported")
