"""`slam bench calibration-logs`: what real logs say of the robots that recorded them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.logs.parts import Recording

from benchmarks.benchmark import logs_in
from slam.evaluation.calibration.fit import fit_calibration
from slam.evaluation.calibration.intervals import DriveData, IntervalCollector
from slam.evaluation.calibration.model import Model
from slam.evaluation.calibration.result import Calibration, calibrate, stated_values
from slam.runs.errors import RunError
from slam.tools.imports import import_log

AXES = ("along_mm", "across_mm", "heading_mrad")


def bench_calibration_logs(data: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Calibrate every log of `data`/benchmark, whole and in halves; only the first with `quick`.

    Raises:
        RunError: no log is there.
    """
    folder = data / "benchmark"
    names = logs_in(folder)[: 1 if quick else None]
    if not names:
        raise RunError(f"{folder}: no NAME.clf.gz with its NAME.relations")
    rows: list[dict[str, Any]] = []
    innovations = {}
    for name in names:
        with tempfile.TemporaryDirectory() as scratch:
            log = Path(scratch) / f"{name}.mcap"
            import_log(folder / f"{name}.clf.gz", log)
            collector = IntervalCollector()
            for message in Recording(log).messages(("/scan", "/odom", "/tf")):
                collector.feed(message)
        drive = collector.data()
        rows += _rows(name, drive)
        innovations[name] = innovation_sizes(drive)
        before, after = innovations[name]["before"], innovations[name]["after"]
        shrunk = ", ".join(f"{axis} {before[axis]:.2f} -> {after[axis]:.2f}" for axis in AXES)
        echo(f"{name}: median innovation of an interval: {shrunk}")
    return {"meta": {"innovations": innovations}, "rows": rows}


def _rows(name: str, drive: DriveData) -> list[dict[str, Any]]:
    whole, first, second = (calibrate([one]) for one in (drive, *halves(drive)))
    return [
        {
            "log": name, "unknown": one.name, "value": one.value, "sigma": one.sigma,
            "apart": _apart(first, second, k), "refused": bool(one.refused),
        }
        for k, one in enumerate(whole.found)
    ]  # fmt: skip


def halves(drive: DriveData) -> tuple[DriveData, DriveData]:
    """The first and the second half of the pieces that could be compared."""
    middle = len(drive.intervals) // 2
    return (
        replace(drive, intervals=drive.intervals[:middle]),
        replace(drive, intervals=drive.intervals[middle:]),
    )


def _apart(first: Calibration, second: Calibration, k: int) -> float:
    a, b = first.found[k], second.found[k]
    return abs(a.value - b.value) / float(np.hypot(a.sigma, b.sigma))


def innovation_sizes(drive: DriveData) -> dict[str, dict[str, float]]:
    """Median differences of odometry and laser over an interval, as stated and as calibrated."""
    model, stated = Model.of(drive), stated_values(drive.stated)
    found = fit_calibration(model, stated)
    return {"before": _medians(model.residuals(stated)), "after": _medians(found.residuals)}


def _medians(residuals: NDArray[np.float64]) -> dict[str, float]:
    sizes = 1e3 * np.median(np.abs(residuals), axis=0)
    return {axis: float(size) for axis, size in zip(AXES, sizes, strict=True)}
