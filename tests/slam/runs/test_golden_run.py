"""A RUN that an older version made can still be shown, judged, optimised, exported, gone on with.

`golden/README.md` says how it was made.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from slam.backend.g2o import read_g2o
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import KeyframeDecision
from slam.logs.trajectory import read_tum

from slam.evaluation.report.evaluate import evaluate
from slam.evaluation.report.write import write_report
from slam.mapping.config import SlamConfig
from slam.runs.reoptimise import reoptimise
from slam.runs.replay import replay
from slam.runs.resume import read_prior_map
from slam.tools.exports import Targets, export
from slam.tools.inspect import describe_log

GOLDEN = Path(__file__).parent / "golden" / "schema1"
SCANS, KEYFRAMES = 190, 8


def test_its_predicted_sigmas_are_told_from_wall_sums():
    with open_log(GOLDEN / "run.mcap") as log:
        first, *others = [m for m in log.messages() if isinstance(m, KeyframeDecision)]
    assert first.predicted_sigmas == ()
    assert len(others) == KEYFRAMES - 1
    assert all(len(d.predicted_sigmas) == 3 and not d.sums for d in others)


def test_info_shows_it():
    shown = describe_log(GOLDEN / "run.mcap")
    assert "lost: nothing" in shown
    assert "/keyframe" in shown


def test_report_judges_it_by_its_truth(tmp_path):
    (report,) = write_report([GOLDEN], None, tmp_path / "report.html")
    assert report.figures["keyframes"] == KEYFRAMES
    assert 0.0 < report.figures["ate_rmse_m"] < 0.05
    assert not report.warnings


def test_reoptimising_moves_no_pose_that_was_optimal(tmp_path):
    summary = reoptimise(GOLDEN, tmp_path / "again", None, [])
    assert (summary["keyframes"], summary["edges"]) == (KEYFRAMES, 2 * (KEYFRAMES - 1))
    before = read_tum(GOLDEN / "trajectory.tum").poses
    after = read_tum(tmp_path / "again" / "trajectory.tum").poses
    assert np.abs(after - before).max() < 1e-4


def test_export_writes_all_that_it_holds(tmp_path):
    targets = Targets(csv=tmp_path / "csv", tum=tmp_path / "t.tum", g2o=tmp_path / "g.g2o")
    assert not export(GOLDEN, targets).lost
    assert len(read_tum(targets.tum)) == SCANS
    assert len(read_g2o(targets.g2o).poses) == KEYFRAMES
    table = (targets.csv / "keyframe.csv").read_text().splitlines()
    assert "predicted_sigmas" in table[0]
    assert len(table) == KEYFRAMES + 1


def test_a_drive_goes_on_in_its_map(tmp_path):
    later_ns = 100 * 10**9
    with LogWriter(tmp_path / "again.mcap", {}) as log:
        for message in islice(simulate(scenario("testbed"), seed=1), 300):
            log.write(replace(message, stamp_ns=message.stamp_ns + later_ns))
    config, out = SlamConfig(), tmp_path / "run"
    prior_map = read_prior_map(GOLDEN, config, "0,0,0")
    summary = replay(tmp_path / "again.mcap", out, config, prior_map=prior_map)
    assert summary["loops"]["accepted"] > 0
    report = evaluate(out).figures
    assert report["keyframes"] > KEYFRAMES
    assert report["ate_rmse_m"] < 0.05
