"""Pose graphs with scans: g2o text with ROBOTLASER1 lines, plain, gzipped, or alone in a zip.

Such a file is a drive that somebody has solved already: each `VERTEX_SE2` is followed by
the scan taken there.  The vertices are the solution, so they become `TruePose` (a reference
only); the odometry is rebuilt by chaining the edges from each vertex to the next.
"""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.importers import carmen_lines
from slam.logs.importers.carmen_lines import LineError, Reach
from slam.logs.importers.imported import ImportedLog
from slam.logs.importers.text_lines import LINE_LIMIT, lines
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, TruePose, WheelOdometry

ZIP_MAGIC = b"PK\x03\x04"
KINDS = {b"VERTEX_SE2", b"EDGE_SE2"}
SENTINEL_M = 50.0  # as in CARMEN logs: farther readings mean that nothing came back

_Pose = tuple[float, float, float]


@dataclass(slots=True)
class _Graph:
    """The lines of one file."""

    vertices: dict[int, _Pose] = field(default_factory=dict)
    scans: dict[int, LaserScan] = field(default_factory=dict)  # by the vertex before
    steps: dict[int, _Pose] = field(default_factory=dict)  # i_T_(i+1), by i
    skipped: Counter[str] = field(default_factory=Counter)
    changed: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)
    last: int | None = None

    def feed(self, line: bytes) -> None:
        """Take in one line."""
        fields = line.split()
        if not fields or fields[0].startswith(b"#"):
            return
        try:
            self._dispatch(fields[0], fields)
        except (LineError, ValueError) as error:
            cause = error if isinstance(error, LineError) else "a field is not a number"
            self.skipped[f"{fields[0][:20].decode('ascii', 'replace')}: {cause}"] += 1

    def _dispatch(self, kind: bytes, fields: list[bytes]) -> None:
        if kind == b"VERTEX_SE2":
            self.last = None
            number, pose = int(fields[1]), _pose(fields[2:5])
            self.vertices[number], self.last = pose, number
        elif kind == b"EDGE_SE2":
            i, j, pose = int(fields[1]), int(fields[2]), _pose(fields[3:6])
            if j == i + 1 and i not in self.steps:
                self.steps[i] = pose
            else:
                self.ignored["EDGE_SE2 that closes a loop"] += 1
        elif kind == b"ROBOTLASER1":
            if self.last is None:
                raise LineError("comes before any vertex")
            read = carmen_lines.robotlaser(fields, Reach())
            if read.repaired:
                self.changed["ranges that were zero, negative or nan, set to nan"] += read.repaired
            self.scans[self.last] = read.scan
        else:
            self.skipped["lines of no known kind"] += 1


def read_g2o_scans(path: Path | str) -> ImportedLog:
    """Read a pose graph with scans into messages in the order of its vertices.

    Raises:
        LogError: if the file cannot be read or holds no scan at a vertex.
    """
    path = Path(path)
    graph = _Graph()
    for line in _lines(path, graph.skipped):
        graph.feed(line)
    if not graph.scans and graph.skipped:
        cause, count = graph.skipped.most_common(1)[0]
        raise LogError(f"{path}: no usable scan: {count} x {cause}")
    if not graph.scans:
        raise LogError(
            f"{path}: holds no ROBOTLASER1 line behind a VERTEX_SE2: a graph without scans "
            "cannot be replayed"
        )
    messages = list(_messages(graph))
    return ImportedLog("g2o with scans", messages, graph.skipped, graph.changed, graph.ignored)


def _lines(path: Path, skipped: Counter[str]) -> Iterator[bytes]:
    with path.open("rb") if path.is_file() else io.BytesIO() as file:
        zipped = file.read(4) == ZIP_MAGIC
    yield from _zipped_lines(path, skipped) if zipped else lines(path, skipped)


def _zipped_lines(path: Path, skipped: Counter[str]) -> Iterator[bytes]:
    try:
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if _is_graph(n)]
            if len(names) != 1:
                raise LogError(f"{path}: holds {len(names)} .g2o files: unpack it and name one")
            with archive.open(names[0]) as file:
                while line := file.readline(LINE_LIMIT):
                    yield line
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        skipped["rest of the file: zip data is damaged or locked"] += 1
        if isinstance(error, RuntimeError):  # encrypted, or an unknown method
            raise LogError(f"{path}: the zip file cannot be unpacked: {error}") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error


def _is_graph(name: str) -> bool:
    """Return whether it is a graph; macOS adds shadows of every file to its zips."""
    return name.lower().endswith((".g2o", ".graph")) and not name.startswith("__MACOSX/")


def _messages(graph: _Graph) -> Iterator[SensorMessage]:
    order = _in_time(graph)
    yield LaserExtrinsics(graph.scans[order[0]].stamp_ns, 0.0, 0.0, 0.0)
    odometry = _chained(graph)
    for number in order:
        scan = graph.scans[number]
        yield WheelOdometry(scan.stamp_ns, *odometry[number])
        yield TruePose(scan.stamp_ns, *graph.vertices[number])
        yield scan


def _in_time(graph: _Graph) -> list[int]:
    """Return the vertices with scans by stamp; those that ran backwards are counted."""
    numbers = sorted(graph.scans)
    stamps = [graph.scans[n].stamp_ns for n in numbers]
    backwards = sum(b < a for a, b in pairwise(stamps))
    if backwards:
        graph.changed["stamps that ran backwards, put in order"] += backwards
    return sorted(numbers, key=lambda n: graph.scans[n].stamp_ns)


def _chained(graph: _Graph) -> dict[int, _Pose]:
    """Return odom_T_vertex; where an edge is missing, the vertices' own step stands in."""
    poses: dict[int, _Pose] = {}
    last: int | None = None
    for number in sorted(graph.vertices):
        if last is None:
            poses[number] = (0.0, 0.0, 0.0)
        else:
            step = graph.steps.get(last) if number == last + 1 else None
            if step is None:
                graph.changed["edges missing between neighbours, taken from the vertices"] += 1
                step = _between(graph.vertices[last], graph.vertices[number])
            poses[number] = _compose(poses[last], step)
        last = number
    return poses


def _pose(fields: Iterable[bytes]) -> _Pose:
    x, y, theta = map(float, fields)
    if not math.isfinite(x + y + theta):
        raise LineError("pose is not finite")
    return x, y, theta


def _compose(a: _Pose, b: _Pose) -> _Pose:
    c, s = math.cos(a[2]), math.sin(a[2])
    theta = math.remainder(a[2] + b[2], math.tau)
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], theta


def _between(a: _Pose, b: _Pose) -> _Pose:
    dx, dy = b[0] - a[0], b[1] - a[1]
    c, s = math.cos(a[2]), math.sin(a[2])
    return c * dx + s * dy, c * dy - s * dx, math.remainder(b[2] - a[2], math.tau)
