"""Pose graphs as text: g2o is written with all digits, g2o and TORO are read and checked.

GTSAM's own writer keeps about six digits, which is not enough to repeat a run.  TORO's files
(`VERTEX2`, `EDGE2`) hold the information as xx xy yy tt xt yt, g2o's as xx xy xt yy yt tt;
some programs wrote TORO's words with g2o's order, which shows where the first is no matrix.
"""

from __future__ import annotations

import gzip
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.backend.edges import Edge, GraphError, Matrix


@dataclass(frozen=True, eq=False, slots=True)
class G2oGraph:
    """A pose graph read from a file; keys are renumbered from 0 in the order of the file's ids."""

    ids: NDArray[np.int64]  # (n,) as in the file
    poses: Matrix  # (n, 3) [x, y, theta]: m, m, rad
    edges: list[Edge]  # between consecutive ids "odometry", all others "loop"
    left_out: Counter[str] = field(default_factory=Counter)  # lines that are not used, by kind
    fixed: int | None = None  # index of the vertex that the file holds fast, None: none

    @property
    def skipped(self) -> int:
        """Lines that are not used."""
        return sum(self.left_out.values())


_VERTICES = ("VERTEX_SE2", "VERTEX2")
_EDGES = ("EDGE_SE2", "EDGE2")
_TORO_ORDER = (0, 1, 3, 5, 2, 4)  # places of xx xy yy tt xt yt among xx xy xt yy yt tt
_REORDERED = "EDGE2 lines whose information is in g2o's order, not TORO's"


def write_g2o(path: Path, poses: Matrix, edges: list[Edge], weights: list[Matrix]) -> None:
    """Write vertices (n, 3) and edges with their information (3, 3); deterministic bytes."""
    lines = [f"VERTEX_SE2 {k} {_join(pose)}" for k, pose in enumerate(poses)]
    for edge, weight in zip(edges, weights, strict=True):
        measured = (edge.i_T_j.x(), edge.i_T_j.y(), edge.i_T_j.theta())
        upper = weight[np.triu_indices(3)]
        lines.append(f"EDGE_SE2 {edge.i} {edge.j} {_join(measured)} {_join(upper)}")
    # At the end: GTSAM's reader stops at the first line that it does not know.
    lines.append("FIX 0")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _join(numbers: object) -> str:
    return " ".join(f"{float(v):.17g}" for v in numbers)  # type: ignore[attr-defined]


def read_g2o(path: Path) -> G2oGraph:
    """Read a 2D g2o or TORO file, plain or gzipped; other kinds of line are counted.

    Raises:
        GraphError: unreadable, malformed, without vertices, or an edge to an unknown vertex.
    """
    vertices: dict[int, tuple[float, float, float]] = {}
    raw: list[tuple[int, tuple[int, int], list[float]]] = []
    left_out: Counter[str] = Counter()
    fixed: list[int] = []
    for number, line in enumerate(_lines(path), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            if fields[0] in _VERTICES and len(fields) == 5:
                vertices[_id(fields[1])] = _pose(fields[2:])
            elif fields[0] in _EDGES and len(fields) == 12:
                ends = _id(fields[1]), _id(fields[2])
                values = [float(f) for f in fields[3:]]
                if fields[0] == "EDGE2":
                    values = _from_toro(values, left_out)
                raw.append((number, ends, values))
            elif fields[0] in (*_VERTICES, *_EDGES):
                raise GraphError(f"{fields[0]} with {len(fields) - 1} numbers")
            elif fields[0] == "FIX":
                fixed += [_id(text) for text in fields[1:]]
            else:
                left_out[f"{_shown(fields[0])} lines"] += 1
        except GraphError as error:
            raise GraphError(f"{path}:{number}: {error}") from error
        except ValueError as error:
            raise GraphError(f"{path}:{number}: not a number: {error}") from error
    if not vertices:
        raise GraphError(f"{path}: holds no VERTEX_SE2; only 2D pose graphs can be read")
    ids = np.array(sorted(vertices), dtype=np.int64)
    index = {int(key): k for k, key in enumerate(ids)}
    edges = [_edge(path, number, ends, values, index) for number, ends, values in raw]
    held = [index[key] for key in dict.fromkeys(fixed) if key in index]
    if extra := len(set(fixed)) - 1 if held else len(set(fixed)):
        left_out["FIX of a further or unknown vertex: one is held"] += extra
    poses = np.array([vertices[int(key)] for key in ids])
    return G2oGraph(ids, poses, edges, left_out, held[0] if held else None)


def _from_toro(values: list[float], left_out: Counter[str]) -> list[float]:
    """Return x, y, theta and the information in g2o's order."""
    pose, stated = values[:3], values[3:]
    reordered = [0.0] * 6
    for value, place in zip(stated, _TORO_ORDER, strict=True):
        reordered[place] = value
    if not _is_matrix(reordered) and _is_matrix(stated):
        left_out[_REORDERED] += 1
        return values
    return pose + reordered


def _is_matrix(upper: list[float]) -> bool:
    """Whether six numbers, row by row from the diagonal on, are a positive definite matrix."""
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = upper
    matrix += np.triu(matrix, 1).T
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > 0)


def _shown(word: str) -> str:
    return word[:40] if word.isprintable() else ascii(word[:40])


def _lines(path: Path) -> list[str]:
    try:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
        return data.decode("ascii").splitlines()
    except OSError as error:
        raise GraphError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, EOFError, zlib.error) as error:
        raise GraphError(f"{path}: is not g2o text: {error}") from error


def _id(text: str) -> int:
    """An id as the arrays can hold it; GTSAM writes its symbols as numbers near the limit."""
    number = int(text)
    if not -(2**63) <= number < 2**63:
        raise GraphError(f"vertex id {text} does not fit into 64 bits")
    return number


def _pose(texts: list[str]) -> tuple[float, float, float]:
    x, y, theta = (float(text) for text in texts)
    if not np.isfinite((x, y, theta)).all():
        raise GraphError("vertex pose is not finite")
    return x, y, theta


def _edge(
    path: Path, number: int, ends: tuple[int, int], values: list[float], index: dict[int, int]
) -> Edge:
    try:
        i, j = index[ends[0]], index[ends[1]]
    except KeyError as error:
        raise GraphError(f"{path}:{number}: edge to unknown vertex {error}") from error
    if i == j:
        raise GraphError(f"{path}:{number}: edge from vertex {ends[0]} to itself")
    information = np.zeros((3, 3))
    information[np.triu_indices(3)] = values[3:]
    information = information + np.triu(information, 1).T
    kind = "odometry" if j - i == 1 else "loop"
    try:
        return Edge(kind, i, j, Pose2(*values[:3]), information)  # type: ignore[arg-type]
    except GraphError as error:
        raise GraphError(f"{path}:{number}: {error}") from error
