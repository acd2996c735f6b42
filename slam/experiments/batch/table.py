"""The table of a batch: a row for each log and combination of settings, as Parquet."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from slam.experiments.batch.grid import Grid, GridPoint, parsed
from slam.experiments.batch.task import LOG

Row = dict[str, Any]

_LOOPS = ("candidates", "accepted", "rejected")
_RELATIONS = (
    *("trans_mean_m", "trans_std_m", "trans_median_m"),
    *("rot_mean_deg", "rot_std_deg"),
)
_ERRORS = (
    *("ate_rmse_m", "ate_median_m", "ate_max_m", "ate_rot_rmse_deg"),
    *("final_pose_error_m", "final_heading_error_deg", "anees"),
)
_TIMES = (
    *("wall_s", "cpu_s", "realtime_factor"),
    *("match_us_median", "step_ms_p50", "step_ms_p99"),
)

# Column, where the record of a task has it, kind.  Only the times depend on the machine.
_FIGURES: tuple[tuple[str, str, Any], ...] = (
    *(
        (name, f"summary.{name}", pa.int64())
        for name in ("scans", "keyframes", "matches", "scan_matches", "lost_keyframes")
    ),
    *((f"loops_{name}", f"summary.loops.{name}", pa.int64()) for name in _LOOPS),
    *((name, f"summary.{name}", pa.float64()) for name in ("distance_m", "duration_s")),
    ("truth", "figures.truth.kind", pa.string()),
    ("relations_n", "figures.relations.n", pa.int64()),
    ("relations_missing", "figures.relations.missing", pa.int64()),
    *((f"relations_{name}", f"figures.relations.{name}", pa.float64()) for name in _RELATIONS),
    *((name, f"figures.{name}", pa.float64()) for name in _ERRORS),
    *(
        (f"rpe_{length}_trans_rmse_m", f"figures.rpe.{length}.trans_rmse_m", pa.float64())
        for length in ("1m", "10m")
    ),
    ("timing_task_s", "seconds", pa.float64()),
    *((f"timing_{name}", f"summary.timing.{name}", pa.float64()) for name in _TIMES),
)
_IDENTITY = ("log_sha256", "config_sha256", "truth_sha256", "version")
_OUTCOME = (
    *(("status", pa.string()), ("reason", pa.string())),
    *(("lost", pa.int64()), ("losses", pa.string()), ("notes", pa.string())),
)


def make_row(
    log: str, grid: Grid, point: GridPoint, identity: Mapping[str, str], record: Mapping[str, Any]
) -> Row:
    """What the table says of one log and combination; figures of a failed one are None."""
    lost = record.get("summary", {}).get("lost", {})
    return {
        "log": log,
        **dict(zip(grid.names, map(parsed, point.values), strict=True)),
        "status": record["status"],
        "reason": record["reason"].replace(LOG, log),
        "lost": sum(lost.values()),
        "losses": "; ".join(f"{count} {cause}" for cause, count in sorted(lost.items())),
        "notes": "; ".join(record.get("figures", {}).get("warnings", [])),
        **{name: _lookup(record, path) for name, path, _ in _FIGURES},
        **{name: identity.get(name) for name in _IDENTITY},
    }


def parquet(rows: Sequence[Row], grid: Grid) -> bytes:
    """The rows as a Parquet file; the same rows give the same bytes."""
    schema = pa.schema(
        [
            ("log", pa.string()),
            *((name, _kind([row[name] for row in rows])) for name in grid.names),
            *_OUTCOME,
            *((name, kind) for name, _, kind in _FIGURES),
            *((name, pa.string()) for name in _IDENTITY),
        ]
    )
    texts = {name for name in grid.names if schema.field(name).type == pa.string()}
    written = [row | {name: str(row[name]) for name in texts} for row in rows]
    stream = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(written, schema), stream, compression="zstd")
    return stream.getvalue()


def is_time(column: str) -> bool:
    """Whether a column depends on the machine."""
    return column.startswith("timing_")


def _kind(values: Sequence[Any]) -> Any:
    """The narrowest kind that holds all values of a setting."""
    kinds = {type(value) for value in values}
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    return pa.float64() if kinds <= {int, float} else pa.string()


def _lookup(record: Mapping[str, Any], path: str) -> Any:
    value: Any = record
    for part in path.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value
