"""How fast logs are written and read, how large they get, and what a sync costs.

Scans are walls with noise, rounded to millimetres as a Hokuyo reports them; beside each
go its raw bytes as they came over the wire, and odometry with its raw packets at 10 Hz:
what the robot records.  The recording's clock is that of the messages, so that chunks are
as small as they would be on the robot, however fast the machine is.
"""

from __future__ import annotations

import ast
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import LaserScan, Message, RawBytes, WheelOdometry
from slam.logs.partial import PartialFile
from slam.logs.recompress import recompress

START_NS = 1_700_000_000 * 10**9
HOUR_S = 3600.0
CYCLE_S = 60.0
"""What is repeated to fill an hour: more than a large chunk, or zstd would see repetitions."""


@dataclass(frozen=True, slots=True)
class Sensors:
    """What a robot records."""

    name: str
    beams: int
    scan_hz: float
    odometry_hz: float = 10.0


SENSORS = (
    Sensors("181 beams 10 Hz", 181, 10.0),
    Sensors("1081 beams 40 Hz", 1081, 40.0),
)


def drive(sensors: Sensors, seconds: float, seed: int = 0) -> Iterator[Message]:
    """Yield what such a robot records in so many seconds, in stamp order."""
    rng = np.random.default_rng(seed)
    bearing = np.linspace(-2.0, 2.0, sensors.beams)
    every = max(int(sensors.scan_hz / sensors.odometry_hz), 1)
    for k in range(int(seconds * sensors.scan_hz)):
        stamp_ns = START_NS + int(k * 1e9 / sensors.scan_hz)
        if k % every == 0:
            yield RawBytes(stamp_ns, "p3dx", "rx", rng.bytes(8) + b"\x32" * 30)
            yield WheelOdometry(stamp_ns, 0.03 * k, 0.001 * k, 0.0)
        wall = np.minimum(2.0 / np.maximum(np.abs(np.sin(bearing + 1e-3 * k)), 0.1), 15.0)
        millimetres = np.rint(1000.0 * (wall + rng.normal(0.0, 0.01, sensors.beams)))
        yield RawBytes(stamp_ns, "laser", "rx", _characters(millimetres.astype(np.int64)))
        ranges = (millimetres / 1000.0).astype(np.float32)
        yield LaserScan(stamp_ns, -2.0, float(bearing[1] - bearing[0]), ranges, 0.02, 30.0)


def _characters(millimetres: Any) -> bytes:
    """Return ranges as three characters of six bits each, as SCIP sends them."""
    digits = np.stack([millimetres >> 12, millimetres >> 6 & 63, millimetres & 63], axis=1)
    return bytes((digits + 0x30).astype(np.uint8).tobytes())


def measure_logs(folder: Path, seconds: float = HOUR_S) -> list[dict[str, Any]]:
    """Write, recompress and read a log for each set of sensors; return rows of a table.

    Row keys: `case`, `log_s` (length of the log), `messages`, `write_per_s` and `read_per_s`
    (messages a second of wall time), `write_x_realtime`, `mb_per_hour` (as recorded),
    `mb_per_hour_closed` (recompressed), `recompress_s`, `read_rss_mb` (what reading adds to
    the peak memory of a fresh process), `read_peak_rss_mb` (that peak, libraries included).

    Args:
        folder: where the logs are written; they are removed again.
        seconds: length of the logs.

    Raises:
        LogError: if there is no room.
    """
    return [_measure(folder, sensors, seconds) for sensors in SENSORS]


def _measure(folder: Path, sensors: Sensors, seconds: float) -> dict[str, Any]:
    path = folder / f"bench-{sensors.beams}.mcap"
    cycle = list(drive(sensors, min(seconds, CYCLE_S)))
    try:
        messages, write_s = _write(path, cycle, seconds)
        smaller = recompress(path)
        recompress_s = time.perf_counter() - write_s[1]
        read_per_s, added_mb, peak_mb = _in_fresh_process(path)
    finally:
        path.unlink(missing_ok=True)
    per_hour = HOUR_S / seconds / 1e6
    return {
        "case": sensors.name,
        "log_s": seconds,
        "messages": messages,
        "write_per_s": round(messages / write_s[0]),
        "write_x_realtime": seconds / write_s[0],
        "read_per_s": round(read_per_s),
        "mb_per_hour": smaller.bytes_before * per_hour,
        "mb_per_hour_closed": smaller.bytes_after * per_hour,
        "recompress_s": recompress_s,
        "read_rss_mb": added_mb,
        "read_peak_rss_mb": peak_mb,
    }


def _write(path: Path, cycle: list[Message], seconds: float) -> tuple[int, tuple[float, float]]:
    """Write the messages over and over with later receipts; return count and (duration, end)."""
    now = [0.0]
    count, began = 0, time.perf_counter()
    period_ns = int(min(seconds, CYCLE_S) * 1e9)
    with LogWriter(path, clock=lambda: now[0], keep_partial=False) as log:
        for lap in range(max(round(seconds / (period_ns * 1e-9)), 1)):
            for message in cycle:
                receipt_ns = message.stamp_ns + lap * period_ns
                now[0] = (receipt_ns - START_NS) * 1e-9
                log.write(message, receipt_ns)
                count += 1
    end = time.perf_counter()
    return count, (end - began, end)


def _in_fresh_process(path: Path) -> tuple[float, float, float]:
    """Run `read_all` in an interpreter that has nothing else in memory."""
    code = (
        f"import sys; from {__name__} import read_all; "
        f"sys.stdout.write(repr(read_all({str(path)!r})))"
    )
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=True,
        text=True,
        env=os.environ | {"PYTHONPATH": paths},
    )
    rate, added_mb, peak_mb = ast.literal_eval(done.stdout)
    return rate, added_mb, peak_mb


def read_all(path: Path | str) -> tuple[float, float, float]:
    """Read a log; return messages a second, what it added to the peak memory, and that (MB)."""
    before = peak_rss_mb()
    began = time.perf_counter()
    with open_log(path) as log:
        count = sum(1 for _ in log.messages())
    rate = count / (time.perf_counter() - began)
    return rate, peak_rss_mb() - before, peak_rss_mb()


def peak_rss_mb() -> float:
    """Return the largest memory this process has had so far (MB).

    Linux hands `ru_maxrss` down from parent to child, so its own account is asked first.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def measure_sync(folder: Path, syncs: int = 40, bytes_each: int = 20_000) -> dict[str, Any]:
    """Return what a sync of a chunk's worth of new bytes costs on a folder's disk (ms)."""
    out = PartialFile(folder / "bench-sync", keep=False)
    costs = []
    try:
        for _ in range(syncs):
            out.stream.write(bytes(bytes_each))
            began = time.perf_counter()
            out.sync()
            costs.append(1e3 * (time.perf_counter() - began))
    finally:
        out.abandon()
    costs.sort()
    return {
        "case": "fsync",
        "syncs": syncs,
        "sync_ms_median": statistics.median(costs),
        "sync_ms_p99": costs[int(0.99 * (syncs - 1))],
        "sync_ms_most": costs[-1],
    }


def log_rows(folder: Path | str, seconds: float = HOUR_S) -> list[dict[str, Any]]:
    """Return the whole table of `slam bench log`; an hour of logs takes about two minutes.

    Raises:
        LogError: if the folder cannot be written.
    """
    return [*measure_logs(Path(folder), seconds), measure_sync(Path(folder))]
