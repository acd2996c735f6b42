"""`slam bench matcher`: time, accuracy, basin and consistency of the scan matcher and its peers.

All methods see the same pairs in the same run on one thread.  The clock goes round the methods
pair by pair, so that whatever else the machine does hits all alike.  Each match is timed twice:
right after the same method worked on another pair, with code and processor warm and data cold, and
warm throughout, when the same match is repeated.
"""

from __future__ import annotations

import gc
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from rich.console import Console
from rich.table import Table
from slam.frontend.scan import ScanConfig, prepare

from benchmarks.matcher.consistency import WORLDS, consistency
from benchmarks.matcher.pairs import BEAMS, CENTRED, LOGS, Pair, real_pairs, synthetic_pairs
from benchmarks.matcher.peers import FAR_REACH, REACH, Peer, all_peers
from benchmarks.matcher.startup import startup

Echo = Callable[[str], None]

SEED = 7
REPEATED = 5  # times that a match is made again to be timed warm; the median counts
SUCCESS = (0.1, np.radians(2.0))  # m, rad: nearer than this is converged
REFERENCE = "small_gicp_icp"  # whose built time the ratio is taken to


@dataclass(frozen=True, slots=True)
class Counts:
    """How much is measured."""

    synthetic: int  # pairs a beam count
    real: int  # pairs a log
    matches: int  # simulated matches a world, for consistency


FULL = Counts(synthetic=150, real=150, matches=1000)
QUICK = Counts(synthetic=12, real=8, matches=100)


def bench_matcher(data: Path, quick: bool, echo: Echo) -> dict[str, Any]:
    """Measure the matchers; `data` holds `benchmark/` with the public logs.

    Raises:
        BenchError: if a library to compare with is not installed.
    """
    counts, peers = QUICK if quick else FULL, all_peers()
    rows: list[dict[str, Any]] = []
    for beams in BEAMS:
        echo(f"simulated pairs, {beams} beams")
        pairs = synthetic_pairs(beams, counts.synthetic, SEED)
        rows += measure(peers, pairs, "synthetic")
    for name in LOGS:
        if not (data / "benchmark" / f"{name}.clf.gz").exists():
            echo(f"{data / 'benchmark'}: no {name}.clf.gz, left out")
            continue
        echo(f"real pairs, {name}")
        rows += measure(peers, real_pairs(data / "benchmark", name, counts.real, SEED), name)
    found = []
    for world in WORLDS:
        echo(f"consistency, {world}")
        found.append(consistency(world, counts.matches))
    if not quick:
        echo("start-up, with no compiled kernels and with")
    begin = {} if quick else startup()
    _show(rows, found, begin)
    return {"meta": _meta(counts, found, begin), "rows": rows}


def _meta(counts: Counts, found: list[dict[str, Any]], begin: dict[str, float]) -> dict[str, Any]:
    versions = {name: version(name) for name in ("numpy", "scipy", "numba", "small-gicp")}
    return {
        "threads": 1,
        "processors": os.cpu_count(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "versions": versions,
        "seed": SEED,
        "success_m": SUCCESS[0],
        "success_deg": float(np.degrees(SUCCESS[1])),
        "counts": {"synthetic": counts.synthetic, "real": counts.real, "matches": counts.matches},
        "us_median": "ours: scans prepared; libraries: from points, trees and normals included",
        "us_median_built": "scans prepared or trees built; data cold",
        "us_median_warm": f"the same, repeated: median of {REPEATED}",
        "consistency": found,
        "startup": begin,
    }


@dataclass(slots=True)
class _Record:
    """What one method did on all pairs."""

    built_us: list[float] = field(default_factory=list)
    warm_us: list[float] = field(default_factory=list)
    whole_us: list[float] = field(default_factory=list)
    errors: list[tuple[float, float]] = field(default_factory=list)
    far: list[bool] = field(default_factory=list)
    fixed: list[bool] = field(default_factory=list)


def measure(peers: list[Peer], pairs: list[Pair], source: str) -> list[dict[str, Any]]:
    """One row for each method on these pairs."""
    records = {peer.name: _Record() for peer in peers}
    prepared_us = []
    gc.disable()  # a collection would hit whichever method runs just then
    try:
        for k, pair in enumerate(pairs):
            prepared_us.append(_prepare_us(pair, pairs[k - 1]))
            shift = k % len(peers)
            for peer in peers[shift:] + peers[:shift]:
                _observe(peer, pair, pairs[k - 1], records[peer.name])
            gc.collect()
    finally:
        gc.enable()
    rows = [_row(peer.name, records[peer.name], pairs, source) for peer in peers]
    reference = next(row for row in rows if row["matcher"] == REFERENCE)
    for row in rows:
        for how in ("built", "warm"):
            key = f"us_median_{how}"
            row[f"times_faster_than_small_gicp_icp_{how}"] = reference[key] / row[key]
        row["prepare_us_median"] = float(np.median(prepared_us))
    return rows


def _observe(peer: Peer, pair: Pair, other: Pair, record: _Record) -> None:
    built, other_built = peer.build(pair), peer.build(other)
    peer.align(other_built, other.guess, REACH)
    us, found = _timed(lambda: peer.align(built, pair.guess, REACH))
    record.built_us.append(us)
    again = [_timed(lambda: peer.align(built, pair.guess, REACH))[0] for _ in range(REPEATED)]
    record.warm_us.append(float(np.median(again)))
    record.errors.append(pair.error(found))
    record.whole_us.append(_timed(lambda: peer.whole(pair, pair.guess))[0])
    for guess, outcomes in ((pair.far_guess, record.far), (pair.fixed_guess, record.fixed)):
        off, turned = pair.error(peer.align(built, guess, FAR_REACH))
        outcomes.append(off < SUCCESS[0] and turned < SUCCESS[1])


def _timed(work: Callable[[], Pose2]) -> tuple[float, Pose2]:
    begin = time.perf_counter_ns()
    found = work()
    return (time.perf_counter_ns() - begin) * 1e-3, found


def _prepare_us(pair: Pair, other: Pair) -> float:
    config = ScanConfig()
    prepare(other.raw[1], CENTRED, config)
    begin = time.perf_counter_ns()
    prepare(pair.raw[1], CENTRED, config)
    return (time.perf_counter_ns() - begin) * 1e-3


def _row(name: str, record: _Record, pairs: list[Pair], source: str) -> dict[str, Any]:
    library = name.startswith(("small_gicp", "scipy"))
    timed = record.whole_us if library else record.built_us
    off, turned = np.array(record.errors).T
    return {
        "matcher": name,
        "beams": len(pairs[0].source.points),
        "pairs_from": source,
        "pairs": len(pairs),
        "us_median": float(np.median(timed)),
        "us_p99": float(np.percentile(timed, 99)),
        "us_median_built": float(np.median(record.built_us)),
        "us_p99_built": float(np.percentile(record.built_us, 99)),
        "us_median_warm": float(np.median(record.warm_us)),
        "us_median_whole": float(np.median(record.whole_us)),
        "error_trans_m_median": float(np.median(off)),
        "error_trans_m_p90": float(np.percentile(off, 90)),
        "error_rot_deg_median": float(np.degrees(np.median(turned))),
        "success": float(np.mean((off < SUCCESS[0]) & (turned < SUCCESS[1]))),
        "basin_success": float(np.mean(record.far)),
        "basin_success_fixed": float(np.mean(record.fixed)),
    }


def _show(rows: list[dict[str, Any]], found: list[dict[str, Any]], begin: dict[str, Any]) -> None:
    console = Console()
    if not console.is_terminal:
        console = Console(width=150)  # a file has no edge to wrap at
    table = Table(title="Matchers: same pairs, same run, one thread")
    heads = "pairs beams matcher us p99 built x warm x whole mm deg basin 0.3m+15deg".split()
    for head in heads:
        table.add_column(
            head, justify="left" if head in ("pairs", "matcher") else "right", no_wrap=True
        )
    for k, row in enumerate(rows):
        last = k + 1 == len(rows) or rows[k + 1]["matcher"] == rows[0]["matcher"]
        table.add_row(*_cells(row), end_section=last)
    console.print(table)
    table = Table(title="Consistency of the covariance (ANEES, 95 % band; should be 1)")
    for head in ("world", "matches", "x", "y", "theta", "band", "along/across", "inside 3 sigma"):
        table.add_column(head, justify="left" if head == "world" else "right")
    for row in found:
        low, high = row["band"]
        table.add_row(
            row["world"], str(row["matches"]), *(f"{value:.2f}" for value in row["anees"]),
            f"{low:.2f}-{high:.2f}", f"{row['sigma_ratio_median']:.0f}",
            f"{100 * min(row['inside_3_sigma']):.1f} %",
        )  # fmt: skip
    console.print(table)
    for name, seconds in begin.items():
        console.print(f"{name}: {seconds:.1f}")


def _cells(row: dict[str, Any]) -> list[str]:
    return [
        row["pairs_from"], str(row["beams"]), row["matcher"], f"{row['us_median']:.0f}",
        f"{row['us_p99']:.0f}",
        f"{row['us_median_built']:.0f}", f"{row['times_faster_than_small_gicp_icp_built']:.1f}",
        f"{row['us_median_warm']:.0f}", f"{row['times_faster_than_small_gicp_icp_warm']:.1f}",
        f"{row['us_median_whole']:.0f}",
        f"{1e3 * row['error_trans_m_median']:.2f}", f"{row['error_rot_deg_median']:.3f}",
        f"{100 * row['basin_success']:.0f} %", f"{100 * row['basin_success_fixed']:.0f} %",
    ]  # fmt: skip
