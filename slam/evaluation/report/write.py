"""`slam report`: a page for people and the same numbers as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from slam.evaluation.report.compare import group_runs, groups_json
from slam.evaluation.report.evaluate import Frame, RunReport, evaluate_run
from slam.evaluation.report.html import render
from slam.evaluation.report.paired import compare_with_first, paired_json
from slam.evaluation.report.read_run import read_run
from slam.evaluation.report.truth import read_truth
from slam.logs.atomic_write import atomic_write
from slam.runs.errors import ReportError

SCHEMA_VERSION = 1  # of report.json, as report.schema.json beside this module describes it


def write_report(
    run_dirs: Sequence[Path], truth: Path | None, out_html: Path, frame: Frame = "base"
) -> tuple[RunReport, ...]:
    """Evaluate runs and write one page, and beside it the same numbers as JSON.

    Raises:
        ReportError: if there is no run, or a run, the truth or the output cannot be used.
    """
    if not run_dirs:
        raise ReportError("no run was given to report on")
    known = read_truth(truth) if truth else None
    reports = tuple(evaluate_run(read_run(path), known, frame) for path in run_dirs)
    runs, all_figures = [r.run for r in reports], [r.figures for r in reports]
    groups, pairs = group_runs(runs, all_figures), compare_with_first(reports)
    document = {
        "schema_version": SCHEMA_VERSION,
        "runs": all_figures,
        "groups": groups_json(groups, runs),
        "paired": paired_json(pairs),
    }
    figures = json.dumps(document, indent=2, allow_nan=False) + "\n"
    page = render(reports, groups, pairs)
    for path, text in ((out_html, page), (out_html.with_suffix(".json"), figures)):
        try:
            atomic_write(path, text)
        except OSError as error:
            raise ReportError(
                f"{path}: cannot be written: {error.strerror}: choose another --out"
            ) from error
    return reports
