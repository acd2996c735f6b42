"""What a run is judged by: relations, a trajectory, or a few surveyed poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from slam.evaluation.relations import Relations, read_relations
from slam.logs.trajectory import (
    NS,
    Trajectory,
    parse_stamp,
    path_length,
    read_tum,
    sorted_trajectory,
)
from slam.runs.errors import ReportError

_RATE_HZ = 10.0  # of the speed signals that are compared to find a clock offset
_LEAST_CORRELATION = 0.55  # of these signals (0.91 at best), for an offset to be believed
_LEAST_GAIN = 0.05  # in correlation over no offset at all


@dataclass(frozen=True, eq=False)
class Truth:
    """One kind of truth: `relations` has relations, the other two a trajectory."""

    kind: Literal["relations", "trajectory", "survey"]
    source: str  # file name or channel
    relations: Relations | None = None
    trajectory: Trajectory | None = None


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Add `seconds` to the truth's stamps and it moves when the run does."""

    seconds: float
    correlation: float


def read_truth(path: Path) -> Truth:
    """Read truth of any kind: relations, TUM, or survey lines `t,x,y,theta`.

    The suffixes .relations, .tum and .csv decide; for others the first line does: commas
    make a survey, a unit quaternion at the end makes TUM.

    Raises:
        ReportError: if the file cannot be read or a line is malformed.
    """
    kind = {".relations": "relations", ".tum": "trajectory", ".csv": "survey"}.get(path.suffix)
    kind = kind or _guess_kind(path)
    if kind == "relations":
        return Truth("relations", path.name, relations=read_relations(path))
    trajectory = read_tum(path) if kind == "trajectory" else _read_survey(path)
    finite = np.all(np.isfinite(trajectory.poses), axis=1)
    if not finite.any():
        raise ReportError(f"{path}: holds no true pose")
    trajectory = trajectory.select(finite)
    return Truth(
        "trajectory" if kind == "trajectory" else "survey", path.name, trajectory=trajectory
    )


def _guess_kind(path: Path) -> str:
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise ReportError(f"{path}: cannot be read: {error.strerror}") from error
    first = next((s for s in lines if s.strip() and not s.lstrip().startswith("#")), "")
    try:
        numbers = [float(s) for s in first.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 8:
        return "survey"
    return "trajectory" if abs(np.linalg.norm(numbers[4:]) - 1.0) < 1e-3 else "relations"


def _read_survey(path: Path) -> Trajectory:
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise ReportError(f"{path}: cannot be read: {error.strerror}") from error
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(lines, start=1):
        heading = number == 1 and line.strip().startswith("t")
        if not line.strip() or line.lstrip().startswith("#") or heading:
            continue
        try:
            stamp, x, y, theta = line.replace(",", " ").split()
            stamps.append(parse_stamp(stamp))
            poses.append((float(x), float(y), float(theta)))
        except ValueError as error:
            raise ReportError(
                f"{path}:{number}: not a surveyed pose `t,x,y,theta`: {error}"
            ) from error
    return sorted_trajectory(stamps, poses)


def sample(trajectory: Trajectory, wanted_ns: NDArray[np.int64], slack_s: float) -> Trajectory:
    """Return the trajectory at the wanted times, interpolated; times beyond its ends are dropped.

    Up to `slack_s` beyond an end, where the robot stands, the end's pose is taken.
    """
    stamps = trajectory.stamps_ns
    slack = round(slack_s * NS)
    wanted = wanted_ns[(wanted_ns >= stamps[0] - slack) & (wanted_ns <= stamps[-1] + slack)]
    at = (wanted - stamps[0]) / NS
    seconds = trajectory.seconds()
    columns = [trajectory.poses[:, 0], trajectory.poses[:, 1], np.unwrap(trajectory.poses[:, 2])]
    poses = np.stack([np.interp(at, seconds, column) for column in columns], axis=-1)
    return Trajectory(wanted, poses.reshape(-1, 3))


def find_clock_offset(estimate: Trajectory, truth: Trajectory) -> ClockOffset | None:
    """Look for the shift in time at which both trajectories move and turn alike.

    Compares speed and turn rate, which need no common frame.  None if the trajectories are
    too short or too sparse, do not resemble each other, or fit best as they are.
    """
    signals = [_motion(estimate), _motion(truth)]
    if signals[0] is None or signals[1] is None:
        return None
    ours, theirs = signals[0], signals[1]
    overlap = correlate(np.ones(ours.shape[1]), np.ones(theirs.shape[1]), method="fft").round()
    least = min(ours.shape[1], theirs.shape[1])
    # Of equally good shifts (a robot on its rounds) the one with more overlap is to win.
    score = np.mean(
        [correlate(a, b, method="fft") for a, b in zip(ours, theirs, strict=True)], axis=0
    ) / (np.maximum(overlap, 1.0) + 0.1 * least)
    score[overlap < 0.5 * least] = -1.0
    best = int(np.argmax(score))
    start_difference = float(estimate.stamps_ns[0] - truth.stamps_ns[0]) / NS
    lag = best - (theirs.shape[1] - 1)
    seconds = start_difference + (lag + _peak_shift(score, best)) / _RATE_HZ
    unshifted = best + round(-seconds * _RATE_HZ)
    now = float(score[unshifted]) if 0 <= unshifted < len(score) else -1.0
    if score[best] < _LEAST_CORRELATION or abs(seconds) < 0.5 / _RATE_HZ:
        return None
    return ClockOffset(seconds, float(score[best])) if score[best] > now + _LEAST_GAIN else None


def _motion(trajectory: Trajectory) -> NDArray[np.float64] | None:
    """Return speed and turn rate at `_RATE_HZ`, each of mean 0 and variance 1; None if dull."""
    seconds = trajectory.seconds()
    if len(seconds) < 20 or seconds[-1] < 5.0 or np.median(np.diff(seconds)) > 0.5:
        return None
    grid = np.arange(0.0, seconds[-1], 1.0 / _RATE_HZ)
    travelled = np.interp(grid, seconds, path_length(trajectory.poses))
    heading = np.interp(grid, seconds, np.unwrap(trajectory.poses[:, 2]))
    rates = np.diff(np.stack([travelled, heading]), axis=1)
    spread = rates.std(axis=1, keepdims=True)
    if np.all(spread < 1e-6):
        return None
    return np.asarray((rates - rates.mean(axis=1, keepdims=True)) / np.maximum(spread, 1e-6))


def _peak_shift(score: NDArray[np.float64], best: int) -> float:
    """Return where between the samples the peak lies, by a parabola through three of them."""
    if not 0 < best < len(score) - 1:
        return 0.0
    before, peak, after = score[best - 1 : best + 2]
    bend = before - 2.0 * peak + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0
