"""`slam.evaluate`: a run's errors against ground truth, for programs and notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.report.evaluate import RunReport, evaluate_run
from slam.evaluation.report.read_run import Run as StoredRun
from slam.evaluation.report.read_run import RunRecords, read_run
from slam.evaluation.report.truth import read_truth
from slam.logs.trajectory import sorted_trajectory
from slam.runs.run import Run


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of a run; `figures` has the keys of `report.json`, None where nothing is known."""

    report: RunReport

    @property
    def figures(self) -> dict[str, Any]:
        """All figures, by the names that `report.json` has."""
        return self.report.figures

    @property
    def trans_errors(self) -> NDArray[np.float64]:
        """(n,) m, of every relation or of every pose that has a true one; empty without truth."""
        report = self.report
        if report.relations is not None:
            return np.asarray(report.relations.trans_m)
        return np.empty(0) if report.errors is None else report.errors.trans_m

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of the figures should know."""
        return self.report.warnings

    def __str__(self) -> str:
        figures = self.figures
        if relations := figures["relations"]:
            return (
                f"relations {relations['trans_mean_m']:.4f} +- {relations['trans_std_m']:.4f} m, "
                f"{relations['rot_mean_deg']:.3f} +- {relations['rot_std_deg']:.3f} deg "
                f"(n = {relations['n']}, {relations['missing']} missing)"
            )
        if figures["ate_rmse_m"] is not None:
            return (
                f"ATE {figures['ate_rmse_m']:.4f} m rmse, "
                f"final pose error {figures['final_pose_error_m']:.4f} m"
            )
        return "no truth: nothing to compare with"


def evaluate(run: Run | str | Path, truth: str | Path | None = None) -> Evaluation:
    """Compare a run with ground truth.

    Args:
        run: from `slam.replay`, or the path of a RUN directory.
        truth: relations, a TUM trajectory, or surveyed poses (CSV); None takes the true poses that
            the log itself holds, if any.

    Raises:
        ReportError: the run or the truth cannot be used.
        LogError: a file cannot be read.
    """
    stored = _stored(run) if isinstance(run, Run) else read_run(Path(run))
    known = read_truth(Path(truth)) if truth is not None else None
    return Evaluation(evaluate_run(stored, known))


def _stored(run: Run) -> StoredRun:
    """A run in memory as the report takes it."""
    result, slam = run.finished.result, run.finished.result.slam
    true = [(t.stamp_ns, (t.x, t.y, t.theta)) for t in result.truth]
    records = RunRecords(
        truth=sorted_trajectory([t for t, _ in true], [p for _, p in true]) if true else None,
        decisions=tuple(slam.records.decisions),
        closure_results=tuple(slam.loops.closure_results),
        factors=tuple(slam.records.factors),
        estimates=tuple(result.estimates),
        scans=tuple(keyframe.scan for keyframe in slam.keyframes),
        extrinsics=slam.extrinsics,
        config=run.config.model_dump(mode="json"),
    )
    name = Path(run.finished.log).stem or "run"
    return StoredRun(
        name, result.trajectory, result.keyframes, result.odometry, result.grid, run.summary,
        records,
    )  # fmt: skip
