"""Errors of runs against their truth: the numbers of `report.json` and what the page draws."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import between, compose, wrap
from slam.evaluation.metrics import (
    Association,
    Credibility,
    absolute_errors,
    align,
    anchor,
    associate,
    credibility,
    nees,
    pairs_by_path,
    relative_errors,
    summarise,
)
from slam.evaluation.relations import RelationErrors, nearest_rows, relation_errors
from slam.evaluation.report.consistency import consistency
from slam.evaluation.report.credibility import credibility_figures
from slam.evaluation.report.read_run import Run, read_run
from slam.evaluation.report.truth import Truth, find_clock_offset, read_truth, sample
from slam.logs.trajectory import NS, Poses, Stamps, Trajectory, path_length
from slam.runs.errors import ReportError

Frame = Literal["base", "laser"]
RPE_LENGTHS_M = (1.0, 5.0, 10.0, 50.0)

# Always there, so that a reader need not ask; null where the truth does not tell.
_TRUTH_KEYS = (
    *("relations", "ate_rmse_m", "ate_median_m", "ate_max_m", "ate_rot_rmse_deg"),
    *("ate_unaligned_rmse_m", "ate_start_aligned_rmse_m", "rpe", "final_pose_error_m"),
    *("final_heading_error_deg", "pairs", "anees", "credibility"),
)

SURVEY_SLACK_S = 2.0
"""A surveyed time may lie so far beyond the run's ends, where the robot stands still."""


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors along the run, against a trajectory or survey that was aligned to the map."""

    rows: NDArray[np.intp]  # (n,) of the run's trajectory: the pose that each belongs to
    stamps_ns: Stamps  # (n,)
    at_s: NDArray[np.float64]  # (n,) since the run's first pose
    at_m: NDArray[np.float64]  # (n,) travelled by the run until then
    trans_m: NDArray[np.float64]
    rot_deg: NDArray[np.float64]
    truth_in_map: Poses  # (n, 3)


@dataclass(frozen=True, eq=False)
class SigmaErrors:
    """Errors of the estimates made on the way, in the base frame, and the sigmas they claimed."""

    at_m: NDArray[np.float64]  # (n,)
    errors: Poses  # (n, 3)
    sigmas: NDArray[np.float64]  # (n, 3)
    nees: NDArray[np.float64]  # (n,)
    credibility: Credibility


@dataclass(frozen=True, eq=False)
class RunReport:
    """All that is known about one run; `figures` are its entry in `report.json`."""

    run: Run
    truth: Truth | None
    figures: dict[str, Any]
    warnings: tuple[str, ...]
    relations: RelationErrors | None = None
    errors: PoseErrors | None = None
    sigmas: SigmaErrors | None = None


def evaluate(run_dir: Path, truth: Path | None = None, frame: Frame = "base") -> RunReport:
    """Judge a run by the truth in a file, or else by the `/truth` channel of its log.

    Raises:
        ReportError: if the run or the truth cannot be read.
    """
    return evaluate_run(read_run(run_dir), read_truth(truth) if truth else None, frame)


def evaluate_run(run: Run, truth: Truth | None, frame: Frame = "base") -> RunReport:
    """Judge a run by a truth, or else by the `/truth` channel of its log.

    The truth speaks of the robot's base, or of its laser, as relations by scan matching do.

    Raises:
        ReportError: the frame is the laser, and the truth is that of the log, or the run does
            not say where the laser sits.
    """
    whole = run
    if frame == "laser":
        run = _at_the_laser(run, truth)
    if truth is None and run.records.truth is not None:
        truth = Truth("trajectory", "/truth", trajectory=run.records.truth)
    warnings = list(run.warnings)
    relations = errors = sigmas = None
    figures = _run_figures(run, truth)
    if truth is None:
        warnings.append("no truth: the figures show consistency, not accuracy")
    elif truth.relations is not None:
        relations = relation_errors(run.trajectory, truth.relations)
        figures["relations"] = relations.summary()
        _warn_of_missing_relations(run.trajectory, truth.relations.first_ns, relations, warnings)
    elif truth.trajectory is not None:
        survey = truth.kind == "survey"
        pairs, shifted = _pair(run.trajectory, truth.trajectory, survey, warnings)
        if len(pairs):
            errors = _pose_errors(run.trajectory, pairs)
            figures |= _trajectory_figures(pairs, run.trajectory, survey)
            sigmas = _sigma_errors(run, shifted, anchor(pairs.estimate.poses, pairs.truth.poses))
            if sigmas is not None:
                figures["anees"] = _number(sigmas.credibility.anees)
                figures["credibility"] = credibility_figures(sigmas.credibility)
    figures["consistency"] = _clean(consistency(whole))
    figures["warnings"] = warnings
    return RunReport(run, truth, figures, tuple(warnings), relations, errors, sigmas)


def _at_the_laser(run: Run, truth: Truth | None) -> Run:
    """The run with the poses of its laser; estimates on the way are of the base, and left out."""
    extrinsics = run.records.extrinsics
    if truth is None:
        raise ReportError(
            f"{run.name}: the truth in its log is of the base: leave --frame laser out"
        )
    if extrinsics is None:
        raise ReportError(f"{run.name}: does not say where the laser sits: leave --frame laser out")
    base_T_laser = np.array([extrinsics.x, extrinsics.y, extrinsics.theta])
    at = run.trajectory
    moved = Trajectory(at.stamps_ns, compose(at.poses, base_T_laser))
    return replace(run, trajectory=moved, records=replace(run.records, estimates=()))


def _run_figures(run: Run, truth: Truth | None) -> dict[str, Any]:
    keys = (
        "log", "log_sha256", "scans", "matches", "keyframes", "loops", "timing", "lost", "version",
        "config_sha256", "host",
    )  # fmt: skip
    return (
        {
            "name": run.name,
            "truth": {"kind": truth.kind, "source": truth.source} if truth else None,
            "distance_m": _distance(run),
            "duration_s": float(run.trajectory.seconds()[-1]),
            "poses": len(run.trajectory),
        }
        | {key: _clean(run.summary.get(key)) for key in keys}
        | {"pruned": _clean(run.summary.get("pruned", run.summary.get("thinned_out")))}
        | dict.fromkeys(_TRUTH_KEYS)
    )


def _distance(run: Run) -> float:
    """Path through the keyframes; over every scan the jitter of a standing robot adds up."""
    known = run.keyframes is not None and len(run.keyframes) > 1
    path = run.keyframes if known and run.keyframes is not None else run.trajectory
    return float(path_length(path.poses)[-1])


def _pair(
    trajectory: Trajectory, truth: Trajectory, survey: bool, warnings: list[str]
) -> tuple[Association, Trajectory]:
    """Bring run and truth together in time; returns the pairs and the truth as it was used."""
    if survey:
        pairs = _pair_survey(trajectory, truth)
    else:
        offset = find_clock_offset(trajectory, truth)
        pairs = associate(trajectory, truth)
        if offset:
            used = "corrected for it" if len(pairs) == 0 else "not corrected for it"
            warnings.append(
                f"clock offset: the truth's clock is {-offset.seconds:+.2f} s off the run's "
                f"(correlation of motion {offset.correlation:.2f}); figures are {used}"
            )
        if offset and len(pairs) == 0:
            truth = Trajectory(truth.stamps_ns + round(offset.seconds * NS), truth.poses)
            pairs = associate(trajectory, truth, max_gap_s=0.05)
    _warn_of_overlap(trajectory, truth, pairs, warnings)
    return pairs, truth


def _pair_survey(trajectory: Trajectory, survey: Trajectory) -> Association:
    found = sample(trajectory, survey.stamps_ns, SURVEY_SLACK_S)
    rows, _ = nearest_rows(survey.stamps_ns, found.stamps_ns, 0.0)
    return Association(found, survey.select(rows))


def _warn_of_overlap(
    run: Trajectory, truth: Trajectory, pairs: Association, warnings: list[str]
) -> None:
    if len(pairs) == 0:
        gap = float(truth.stamps_ns[0] - run.stamps_ns[0]) / NS
        warnings.append(
            f"no pose of the run has a true one at its time: the truth starts {gap:+.1f} s after "
            f"the run and lasts {truth.seconds()[-1]:.1f} s, the run {run.seconds()[-1]:.1f} s"
        )
    elif len(pairs) == 1 and len(truth) > 1:
        warnings.append("only one pose has a true one: nothing to align it with")
    elif len(truth) > 20:
        inside = (run.stamps_ns >= truth.stamps_ns[0]) & (run.stamps_ns <= truth.stamps_ns[-1])
        share = float(np.mean(inside))
        if share < 0.95:
            warnings.append(
                f"the truth covers only {share:.0%} of the run; errors are for that part"
            )


def _warn_of_missing_relations(
    run: Trajectory, times: NDArray[np.int64], found: RelationErrors, warnings: list[str]
) -> None:
    if found.missing:
        total = found.missing + len(found.trans_m)
        warnings.append(
            f"{found.missing} of {total} relations have no pose of the run at their time"
        )
    if len(found.trans_m) == 0:
        gap = float(times.min() - run.stamps_ns[0]) / NS
        warnings.append(f"the relations start {gap:+.1f} s after the run: is this its truth?")


def _pose_errors(trajectory: Trajectory, pairs: Association) -> PoseErrors:
    truth_T_map = align(pairs.estimate.poses, pairs.truth.poses)
    errors = absolute_errors(pairs, truth_T_map)
    rows, _ = nearest_rows(trajectory.stamps_ns, pairs.estimate.stamps_ns, 0.0)
    return PoseErrors(
        rows=rows,
        stamps_ns=pairs.estimate.stamps_ns,
        at_s=(pairs.estimate.stamps_ns - trajectory.stamps_ns[0]) / NS,
        at_m=path_length(trajectory.poses)[rows],
        trans_m=errors.trans_m,
        rot_deg=errors.rot_deg,
        truth_in_map=between(truth_T_map, pairs.truth.poses),
    )


def _trajectory_figures(pairs: Association, run: Trajectory, survey: bool) -> dict[str, Any]:
    if len(pairs) == 1 and not survey:
        return {"pairs": 1}  # aligned to itself it would seem to have no error
    start = run.poses[0] if len(pairs) == 1 else None
    figures: dict[str, Any] = {"pairs": len(pairs)} | _final_pose(pairs, start)
    if len(pairs) == 1:
        return figures  # one pose is aligned to nothing, so it has no absolute error
    estimate, truth = pairs.estimate.poses, pairs.truth.poses
    aligned = absolute_errors(pairs, align(estimate, truth))
    unaligned, anchored = (
        absolute_errors(pairs, p) for p in (np.zeros(3), anchor(estimate, truth))
    )
    ate = summarise(aligned.trans_m)
    return figures | {
        "ate_rmse_m": ate.rmse,
        "ate_median_m": ate.median,
        "ate_max_m": ate.max,
        "ate_rot_rmse_deg": summarise(aligned.rot_deg).rmse,
        "ate_unaligned_rmse_m": summarise(unaligned.trans_m).rmse,
        "ate_start_aligned_rmse_m": summarise(anchored.trans_m).rmse,
        "rpe": {} if survey else {f"{m:g}m": _rpe(pairs, m) for m in RPE_LENGTHS_M},
    }


def _rpe(pairs: Association, length_m: float) -> dict[str, Any]:
    errors = relative_errors(pairs, pairs_by_path(pairs.truth.poses, length_m))
    trans, rot = summarise(errors.trans_m), summarise(errors.rot_deg)
    return {
        "n": trans.n,
        "trans_rmse_m": _number(trans.rmse),
        "trans_mean_m": _number(trans.mean),
        "trans_median_m": _number(trans.median),
        "rot_rmse_deg": _number(rot.rmse),
        "rot_mean_deg": _number(rot.mean),
    }


def _final_pose(pairs: Association, start: Poses | None) -> dict[str, Any]:
    """Return the error of the motion from the first to the last pair.

    A survey of one pose is taken as seen from the `start` of the run, as in the seed paper.
    """
    if start is not None:
        error = between(pairs.truth.poses[-1], between(start, pairs.estimate.poses[-1]))
    else:
        true = between(pairs.truth.poses[0], pairs.truth.poses[-1])
        error = between(true, between(pairs.estimate.poses[0], pairs.estimate.poses[-1]))
    return {
        "final_pose_error_m": float(np.hypot(error[0], error[1])),
        "final_heading_error_deg": math.degrees(abs(float(error[2]))),
    }


def _sigma_errors(run: Run, truth: Trajectory, truth_T_map: Poses) -> SigmaErrors | None:
    """Weigh the estimates made on the way by the covariances they claimed."""
    claimed = [e for e in run.records.estimates if len(e.covariance) == 9]
    if not claimed or len(truth) < 2:
        return None
    stamps = np.array([e.stamp_ns for e in claimed], dtype=np.int64)
    rows, near = nearest_rows(truth.stamps_ns, stamps, 0.01)
    if not near.any():
        return None
    found = np.array([(e.x, e.y, e.theta) for e in claimed])[near]
    covariances = np.array([e.covariance for e in claimed])[near].reshape(-1, 3, 3)
    errors = between(compose(truth_T_map, found), truth.poses[rows[near]])
    errors[:, 2] = wrap(errors[:, 2])
    at, _ = nearest_rows(run.trajectory.stamps_ns, stamps[near], 0.0)
    variances, weighed = np.einsum("nii->ni", covariances), nees(errors, covariances)
    return SigmaErrors(
        at_m=path_length(run.trajectory.poses)[at],
        errors=errors,
        sigmas=np.sqrt(np.where(variances >= 0.0, variances, np.nan)),
        nees=weighed,
        credibility=credibility(weighed),
    )


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _clean(value: Any) -> Any:
    """Return JSON data without the nan and inf that strict readers refuse."""
    if isinstance(value, dict):
        return {str(key): _clean(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_clean(item) for item in value]
    return _number(value) if isinstance(value, float) else value
