"""`slam bench online-faults`: drives with faults on wires, devices and wheels, from one seed.

Each kind of fault ten times and mixtures of up to four; every run is checked (no wrong scan,
no wrong odometry, all counters, replay bit-identical), and its error is compared with that of
the same drive, with the same noise, without faults.  Errors are a few millimetres, so the
spread of fault-free drives that differ in the laser's noise alone stands beside it.

Runs are kept in a file of their own as they are made: stopped and begun again, it goes on there.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.hokuyo_device import HokuyoBuild
from slam.drivers.simulators.link import WireFaults
from slam.drivers.simulators.pioneer_build import PioneerBuild
from slam.logs.mcap_log import open_log

from benchmarks.faults.checks import (
    differences,
    error_m,
    hang_s,
    longest_outage_s,
    scans_lost,
    stamp_errors_ms,
    wrong_counts,
    wrong_odometry,
    wrong_scans,
)
from benchmarks.faults.drive import STARTS_S, DriveFaults, FaultyDrive
from benchmarks.kept_runs import KeptRuns
from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.runs.errors import RunError
from slam.runs.offline import feed, finish
from slam.runs.replay import SLAM_TOPICS

Rng = np.random.Generator
RUNS = 200
_ALONE = 10  # runs of each kind alone; the others are mixtures
_BAUDS = (19200, 38400, 57600, 115200)  # of the robot, while the driver expects 9600
NOISES = 6  # drives without faults that differ in the laser's noise, of each
DRIVES = 5  # different noise of wheels and laser; each is driven without faults as well
DRIVE_S = 16.0  # s of the drive in which a fault may begin
LONG_S = 2.0  # outages of this length and more may cost accuracy
WORSE = 2.0  # times the error without faults; more is a failure
HANG_S = 3.0  # from the request to stop until the device is closed (QT or CLOSE, and waiting)


def _wire(rng: Rng, **what: Any) -> dict[str, Any]:
    """Faults of one wire or of both."""
    where = rng.choice(["robot", "laser", "both"])
    return dict.fromkeys(("robot", "laser") if where == "both" else (where,), what)


def _window(rng: Rng) -> tuple[tuple[float, float]]:
    at = STARTS_S + rng.uniform(1.0, DRIVE_S - 4.0)
    return ((at, at + rng.uniform(0.1, 1.6)),)


def _reboot(rng: Rng) -> tuple[tuple[float, float]]:
    return ((STARTS_S + rng.uniform(1.0, DRIVE_S - 4.0), rng.uniform(0.2, 0.6)),)


def _wheels(rng: Rng, kind: Any, most_s: float) -> dict[str, Any]:
    size = rng.uniform(-0.35, 0.35) if kind == "slip" else None
    at, lasts = rng.uniform(1.0, DRIVE_S - 4.0), rng.uniform(0.3, most_s)
    return {"wheels": OdometryFault(kind, at, lasts, size)}


KINDS: Mapping[str, Any] = MappingProxyType(
    {
        "bit flips": lambda rng: _wire(rng, flip_rate=10.0 ** rng.uniform(-6, -4)),
        "lost bytes": lambda rng: _wire(rng, loss_rate=10.0 ** rng.uniform(-6, -4)),
        "split": lambda rng: _wire(rng, split=int(rng.integers(1, 60))),
        "merged": lambda rng: _wire(rng, hold_s=rng.uniform(0.02, 0.1)),
        "delayed": lambda rng: _wire(rng, delay_s=rng.uniform(0.01, 0.06)),
        "silent": lambda rng: _wire(rng, silences=_window(rng)),
        "unplugged": lambda rng: _wire(rng, unplugged=_window(rng)),
        "robot reboots": lambda rng: {"base": {"reboots": _reboot(rng)}},
        "laser reboots": lambda rng: {"sensor": {"reboots": _reboot(rng)}},
        "wrong baud": lambda rng: {"base": {"baud": int(rng.choice(_BAUDS))}},
        "clock": lambda rng: {
            "sensor": {
                "clock_rate": 1.0 + rng.uniform(-2e-4, 2e-4),
                "clock_start": int(rng.integers((1 << 24) - 30_000, 1 << 24)),  # it wraps too
            }
        },
        "stuck encoder": lambda rng: _wheels(rng, "stuck-encoder", 1.9),
        "wheel slip": lambda rng: _wheels(rng, "slip", 1.0),
    }
)  # fmt: skip


def draw(seed: int) -> tuple[str, DriveFaults]:
    """The faults of run `seed`: the kinds in turn, then mixtures."""
    rng = np.random.default_rng([seed, 6])
    names = list(KINDS)
    chosen = [names[seed % len(names)]]
    if seed >= _ALONE * len(names):
        chosen = sorted(rng.choice(names, size=rng.integers(2, 5), replace=False).tolist())
    faults: dict[str, Any] = {"wheels": (), "robot": {"seed": seed}, "laser": {"seed": seed}}
    for name in chosen:
        for where, what in KINDS[name](rng).items():
            if where == "wheels":
                faults[where] = (*faults[where], what)
            else:
                faults[where] = faults.get(where, {}) | what
    return " + ".join(chosen), DriveFaults(
        robot=WireFaults(**faults["robot"]),
        laser=WireFaults(**faults["laser"]),
        base=PioneerBuild(**faults.get("base", {})),
        sensor=HokuyoBuild(**faults.get("sensor", {})),
        wheels=faults["wheels"],
    )


def run_one(seed: int) -> dict[str, Any]:
    """Drive, check, and compare; the row of the table."""
    name, faults = draw(seed)
    begin = time.process_time()
    row = {
        "seed": seed, "faults": name, "kind": "mixture" if " + " in name else name,
        "drive": seed % DRIVES, **drive_once(seed % DRIVES, faults),
    }  # fmt: skip
    usual = fault_free_m(seed % DRIVES)
    row |= {"fault_free_m": usual, "ratio": round(row["error_m"] / usual, 3)}
    if row["longest_outage_s"] < LONG_S and row["ratio"] > WORSE:
        row["wrong"].append(f"error {row['ratio']:.2f} times that without faults")
    return row | {"cpu_s": round(time.process_time() - begin, 2)}


@lru_cache
def fault_free_m(drive: int, laser_seed: int | None = None) -> float:
    """Error of a drive without faults, m; with other noise of the laser if it has its own seed.

    Raises:
        RunError: a check fails even so.
    """
    row = drive_once(drive, DriveFaults(), laser_seed)
    if row["wrong"]:
        raise RunError(f"without any fault: {', '.join(row['wrong'])}")
    return float(row["error_m"])


def _fault_free(drive: int, laser_seed: int) -> dict[str, Any]:
    return {"m": fault_free_m(drive, laser_seed)}


def drive_once(
    drive_seed: int, faults: DriveFaults, laser_seed: int | None = None
) -> dict[str, Any]:
    """One drive, its live run and its replay: error, counters and what is wrong."""
    drive = FaultyDrive(drive_seed, faults, laser_seed)
    config = SlamConfig()
    with tempfile.TemporaryDirectory(prefix="slam-faults-") as folder:
        log = Path(folder) / "run.mcap"
        slam, sequencer = drive.record(log, config)

        def source() -> Any:
            with open_log(log) as opened:
                yield from opened.messages(SLAM_TOPICS)

        again = Slam(config)
        for message in source():
            feed(again, message)
        again.finish_input()
        wrong = differences(slam, again)
        live = finish(slam, source)
        wrong += wrong_counts(drive, sequencer, log)
    wrong += wrong_scans(drive) + wrong_odometry(drive)
    if hang_s(drive) > HANG_S:
        wrong.append(f"took {hang_s(drive):.1f} s to close the devices")
    late = np.abs(stamp_errors_ms(drive))
    return {
        "stamp_ms_p50": round(float(np.median(late)), 2),
        "stamp_ms_max": round(float(late.max()), 2),
        "error_m": round(error_m(drive, live), 5),
        "longest_outage_s": round(longest_outage_s(drive), 3),
        "scans": drive.laser.counters["scans"],
        "scans_lost": scans_lost(drive.laser.counters),
        "outages": {"p3dx": drive.robot.outages, "laser": drive.laser.outages},
        "counters": {"p3dx": drive.robot.counters, "laser": drive.laser.counters},
        "pipeline_lost": dict(slam.lost),
        "wrong": wrong,
    }


def bench_online_faults(out: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Run the campaign, or what is left of it in `out`; a run that fails a check is a row as well.

    Raises:
        RunError: the file of runs cannot be written.
    """
    seeds = range(0, RUNS, 10 if quick else 1)
    kept = KeptRuns(out / "online-faults.runs.jsonl")
    spread = [
        [kept.made(f"drive {drive}, noise {k}", partial(_fault_free, drive, k))["m"]
         for k in range(100, 100 + (2 if quick else NOISES))]
        for drive in range(DRIVES)
    ]  # fmt: skip
    runs = []
    for seed in seeds:
        row = kept.made(f"run {seed}", partial(run_one, seed))
        runs.append(row)
        found = ", ".join(row["wrong"]) or "sound"
        echo(f"run {seed}, {row['faults']}: {row['ratio']:.2f} times the error, {found}")
    kinds = sorted({row["kind"] for row in runs})
    meta = {
        "drives": DRIVES, "long_outage_s": LONG_S, "worse": WORSE,
        "fault_free_mm": [[round(1e3 * m, 2) for m in sorted(errors)] for errors in spread],
        "fault_free_ratio_most": round(max(max(errors) / min(errors) for errors in spread), 3),
    }  # fmt: skip
    echo(
        f"without faults the noise alone makes one run {meta['fault_free_ratio_most']:.2f} times "
        "as wrong as another of the same drive"
    )
    return {
        "meta": meta,
        "rows": [_summary(kind, [row for row in runs if row["kind"] == kind]) for kind in kinds],
        "runs": runs,
    }


def _summary(kind: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """One row of the table."""
    short = [row["ratio"] for row in runs if row["longest_outage_s"] < LONG_S]
    return {
        "faults": kind,
        "runs": len(runs),
        "outages": sum(sum(row["outages"].values()) for row in runs),
        "scans_lost": sum(row["scans_lost"] for row in runs),
        "long_outages": len(runs) - len(short),
        "worst_ratio": max(short, default=float("nan")),
        "worst_stamp_ms": max(row["stamp_ms_p50"] for row in runs),
        "wrong": sum(bool(row["wrong"]) for row in runs),
    }
