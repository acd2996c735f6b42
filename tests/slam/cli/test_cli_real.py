"""The main job on real recordings, through the real command: import, replay, report, look."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slam.maps.nav2_map import read_nav2_map

ROOT = Path(__file__).parents[3]
DATA = ROOT.parent / "shared" / "data" / "benchmark"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def slam(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "slam", *map(str, arguments)], env=ENVIRONMENT, check=True,
        capture_output=True, text=True, timeout=280,
    )  # fmt: skip


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """A RUN directory of a log of the benchmark, with its report."""

    def run(name):
        log, relations = DATA / f"{name}.clf.gz", DATA / f"{name}.relations"
        if not log.exists():
            pytest.skip(f"real recordings are not at {DATA}")
        folder = tmp_path_factory.mktemp(name)
        slam("import", log, "--out", folder / "log.mcap")
        slam("replay", folder / "log.mcap", "--out", folder / "run")
        slam("report", folder / "run", "--truth", relations)
        return folder / "run"

    return run


@pytest.fixture(scope="module")
def intel(mapped):
    return mapped("intel")


def figures_of(run):
    (figures,) = json.loads((run / "report.json").read_text())["runs"]
    return figures


def test_intel_is_accurate_and_in_time(intel):
    figures = figures_of(intel)
    relations = figures["relations"]
    assert relations["n"] == 2984
    assert relations["missing"] == 0
    assert relations["trans_mean_m"] < 0.10  # by the wheels alone it is 7.37
    assert relations["rot_mean_deg"] < 1.0
    assert relations["trans_max_m"] < 1.0
    assert figures["timing"]["wall_s"] < 120


def test_the_report_has_the_promised_keys(intel):
    figures = figures_of(intel)
    assert set(figures["relations"]) == {
        "n", "missing", "trans_mean_m", "trans_std_m", "trans_median_m",
        "trans_max_m", "rot_mean_deg", "rot_std_deg",
    }  # fmt: skip
    promised = {
        "ate_rmse_m", "ate_median_m", "rpe", "final_pose_error_m", "anees", "matches",
        "keyframes", "timing",
    }  # fmt: skip
    assert promised <= set(figures)
    assert (intel / "report.html").stat().st_size > 10_000


def test_every_scan_of_intel_is_placed(intel):
    assert len((intel / "trajectory.tum").read_text().splitlines()) == 13631
    summary = json.loads((intel / "summary.json").read_text())
    assert summary["scans"] == 13631
    assert summary["lost"] == {}


def test_the_map_of_intel_is_a_building(intel):
    """About 30 m square, most of it free, with thin walls around."""
    grid = read_nav2_map(intel)
    known, occupied = grid.cells >= 0, grid.cells > 65
    area = np.count_nonzero(known) * grid.resolution**2
    assert 400 < area < 1000
    rows, columns = np.nonzero(occupied)
    for cells in (rows, columns):
        low, high = np.percentile(cells, [1, 99])
        assert 20 < (high - low) * grid.resolution < 40
    # A wall that is drawn twice would make more occupied cells for the same rooms.
    assert 0.02 < np.count_nonzero(occupied) / np.count_nonzero(known) < 0.12


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit_m"), [("mit-csail", 0.06), ("mit-killian", 0.10)])
def test_the_other_buildings(mapped, name, limit_m):
    relations = figures_of(mapped(name))["relations"]
    assert relations["missing"] == 0
    assert relations["trans_mean_m"] < limit_m
