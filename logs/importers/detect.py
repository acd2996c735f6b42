"""Any supported foreign log, told apart by what it begins with rather than by its name."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.importers import aria, g2o_scans
from slam.logs.importers.bag.files import ROS1_MAGICS, is_bag
from slam.logs.importers.bag.mcap import channel_of, open_mcap, require_ros
from slam.logs.importers.breezyslam import looks_like_breezyslam, read_breezyslam
from slam.logs.importers.carmen import KINDS, read_carmen
from slam.logs.importers.g2o_scans import read_g2o_scans
from slam.logs.importers.imported import ImportedLog, StreamedLog
from slam.logs.importers.rawlog import is_rawlog, read_rawlog
from slam.logs.importers.rosbag import read_rosbag
from slam.logs.importers.text_lines import lines
from slam.logs.importers.wishes import Wishes
from slam.logs.importers.ydlidar import looks_like_ydlidar, read_ydlidar
from slam.logs.mcap_file import MAGIC
from slam.logs.mcap_open import is_ours

SUPPORTED = (
    "logs of CARMEN (.clf, .log), BreezySLAM (.dat), ARIA (.2d) and MRPT (.rawlog), YDLidar "
    "text, ROS 1 bags, ROS 2 bags (folder, .mcap, .db3), and g2o graphs with ROBOTLASER1 lines; "
    "texts plain or gzipped"
)

_FIELDS = 12_000  # of a line, at most: twice the beams of any laser
_LINES_LOOKED_AT = 2000  # CARMEN logs may begin with hundreds of PARAM lines or comments
_OURS = "{}: is an MCAP log already: use it with `slam replay`"
_NO_WISHES = Wishes()


def read_any(path: Path | str, wishes: Wishes = _NO_WISHES) -> ImportedLog | StreamedLog:
    """Read a foreign log of any kind that is supported.

    Raises:
        LogError: if the file cannot be read, is of no such kind, is our own already, or
            cannot be read without an answer in `wishes`.
    """
    path = Path(path)
    _refuse_run(path)
    start = _start_of(path)
    if start.startswith(MAGIC[:6]):
        _require_foreign(path)
    elif not is_bag(path, start):
        rawlog = is_rawlog(path)
        asked = [option for option in wishes.for_bags_only() if not (rawlog and option == "--scan")]
        if asked:
            raise LogError(f"{path}: is no ROS recording: leave {' and '.join(asked)} out")
        if start.startswith(g2o_scans.ZIP_MAGIC):
            return _read_graph(path, wishes)
        return read_rawlog(path, wishes) if rawlog else _read_text(path, wishes)
    return read_rosbag(path, wishes)


def is_foreign(path: Path) -> bool:
    """Whether a file or folder is none of our logs, as far as its beginning tells.

    Raises:
        LogError: it is a RUN.
    """
    if path.is_dir():
        _refuse_run(path)
        return True
    start = _start_of(path)
    if not start.startswith(MAGIC[:6]):
        return bool(start)  # what cannot be opened is for whoever opens it
    try:
        _require_foreign(path)
    except LogError:
        return False
    return True


def _refuse_run(path: Path) -> None:
    if path.is_dir() and (path / "run.mcap").is_file():
        raise LogError(f"{path}: is a RUN, not a recording: its log is {path / 'run.mcap'}")


def _require_foreign(path: Path) -> None:
    """Refuse an MCAP file that is a log already, or holds nothing of ROS."""
    with open_mcap(path) as log:
        if "schema_version" in log.metadata().get("run", {}):
            raise LogError(_OURS.format(path))
        if not log.has_summary:
            for _ in log.raw_messages():
                pass
        described = [log.described(number) for number in log.channel_ids()]
    found = [(c.topic, s.name if s else "") for c, s in filter(None, described)]
    if any(is_ours(*channel) for channel in found):
        raise LogError(_OURS.format(path))
    require_ros(path, [channel_of(*both) for both in filter(None, described)])


def _start_of(path: Path) -> bytes:
    """Return the first bytes, none if the file cannot be read: `lines` says why."""
    try:
        with path.open("rb") as file:
            return file.read(64)
    except OSError:
        return b""


def _read_text(path: Path, wishes: Wishes) -> ImportedLog:
    for line in islice(lines(path, Counter()), _LINES_LOOKED_AT):
        fields = line.split(maxsplit=_FIELDS)
        if not fields:
            continue
        if fields[0] == aria.FIRST_WORD:
            return aria.read_aria(path, wishes)
        if fields[0].startswith(b"#"):
            continue
        if fields[0] in g2o_scans.KINDS:
            return _read_graph(path, wishes)
        if fields[0] in KINDS:
            return read_carmen(path, wishes)
        if looks_like_breezyslam(fields):
            return read_breezyslam(path, wishes)
        if looks_like_ydlidar(line):
            return read_ydlidar(path, wishes)
    if named := _named(path):
        raise LogError(f"{path}: is {named}")
    raise LogError(f"{path}: is no log of a known kind: {SUPPORTED} can be imported")


def _read_graph(path: Path, wishes: Wishes) -> ImportedLog:
    if wishes != _NO_WISHES:
        raise LogError(f"{path}: is a graph with scans, which is read as it is: leave options out")
    return read_g2o_scans(path)


def _named(path: Path) -> str:
    """Return what a file is that cannot be read, and the way round, empty if nobody knows."""
    start = b"".join(islice(lines(path, Counter()), 3))[:4096]
    if start.startswith((*ROS1_MAGICS, b"SQLite format 3", MAGIC[:6])):
        return "a recording that was packed with gzip: unpack it first"
    if start.startswith((b"VERTEX_SE3", b"VERTEX3", b"EDGE_SE3", b"EDGE3")):
        return "a pose graph in space without scans, which cannot be mapped"
    if start.startswith((b"VERTEX2", b"EDGE2", b"VERTEX ", b"EDGE ")):
        return "a pose graph without scans: `slam reoptimise` solves it"
    if start.startswith((b"## Player", b"# Player")):
        return "a log of Player, which cannot be read: its own `playervcr` plays it"
    return ""
