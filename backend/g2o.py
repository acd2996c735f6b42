"""Pose graphs as g2o text: written with all digits, read leniently but checked.

GTSAM's own writer keeps about six digits, which is not enough to repeat a run.
"""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
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
    skipped: int  # lines of a kind that is not understood


def write_g2o(path: Path, poses: Matrix, edges: list[Edge], weights: list[Matrix]) -> None:
    """Write vertices (n, 3) and edges with their information (3, 3); deterministic bytes."""
    lines = [f"VERTEX_SE2 {k} {_join(pose)}" for k, pose in enumerate(poses)]
    lines.append("FIX 0")
    for edge, weight in zip(edges, weights, strict=True):
        measured = (edge.i_T_j.x(), edge.i_T_j.y(), edge.i_T_j.theta())
        upper = weight[np.triu_indices(3)]
        lines.append(f"EDGE_SE2 {edge.i} {edge.j} {_join(measured)} {_join(upper)}")
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _join(numbers: object) -> str:
    return " ".join(f"{float(v):.17g}" for v in numbers)  # type: ignore[attr-defined]


def read_g2o(path: Path) -> G2oGraph:
    """Read a 2D g2o file, plain or gzipped; other kinds of line are counted.

    Raises:
        GraphError: unreadable, malformed, without vertices, or an edge to an unknown vertex.
    """
    vertices: dict[int, tuple[float, float, float]] = {}
    raw: list[tuple[int, tuple[int, int], list[float]]] = []
    skipped = 0
    for number, line in enumerate(_lines(path), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#") or fields[0] == "FIX":
            continue
        try:
            if fields[0] in ("VERTEX_SE2", "VERTEX2") and len(fields) == 5:
                vertices[_id(fields[1])] = _pose(fields[2:])
            elif fields[0] == "EDGE_SE2" and len(fields) == 12:
                ends = _id(fields[1]), _id(fields[2])
                raw.append((number, ends, [float(f) for f in fields[3:]]))
            elif fields[0] in ("VERTEX_SE2", "VERTEX2", "EDGE_SE2"):
                raise GraphError(f"{fields[0]} with {len(fields) - 1} numbers")
            else:
                skipped += 1
        except GraphError as error:
            raise GraphError(f"{path}:{number}: {error}") from error
        except ValueError as error:
            raise GraphError(f"{path}:{number}: not a number: {error}") from error
    if not vertices:
        raise GraphError(f"{path}: holds no VERTEX_SE2; only 2D pose graphs can be read")
    ids = np.array(sorted(vertices), dtype=np.int64)
    index = {int(key): k for k, key in enumerate(ids)}
    edges = [_edge(path, number, ends, values, index) for number, ends, values in raw]
    return G2oGraph(ids, np.array([vertices[int(key)] for key in ids]), edges, skipped)


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
