"""`slam calibrate`: where the laser sits and what the odometry is worth, from recorded drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from slam.evaluation.calibration.result import (
    LEAST_INTERVALS,
    Calibration,
    calibrate_sources,
)
from slam.evaluation.calibration.unknowns import Found
from slam.logs.atomic_write import atomic_write
from slam.logs.errors import shown
from slam.logs.mcap_open import open_log
from slam.logs.messages import LaserScan, Message, WheelOdometry
from slam.logs.parts import Recording
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError

TRACK = "odometry_track_m"  # in a log's metadata: with which its odometry was computed
_TOPICS = ("/scan", "/odom", "/tf")
_SURE = 3.0  # sigmas from the stated value, that are worth a word
_DIGITS = 6
_PROGRESS_EVERY = 200  # messages


def calibrate_logs(
    logs: Sequence[Path],
    config: SlamConfig,
    track_m: float = 0.0,
    on_progress: Callable[[int], None] = lambda messages: None,
) -> Calibration:
    """Calibrate the robot that recorded all of these logs.

    Args:
        logs: drives of one robot, its laser at one place.
        config: of the matcher.
        track_m: the track width that their odometry was computed with; 0: as they say.
        on_progress: given the number of messages read so far.

    Raises:
        LogError: a log cannot be read.
        RunError: a log holds no scans or no odometry.
    """
    sources = [partial(_messages, log, on_progress) for log in logs]
    track_m = track_m or known_track(logs)
    return calibrate_sources(sources, config.matcher, config.scan, track_m, config.calibration)


def _messages(path: Path, on_progress: Callable[[int], None]) -> Iterator[Message]:
    seen: set[type] = set()
    for count, message in enumerate(Recording(path).messages(_TOPICS), start=1):
        yield message
        seen.add(type(message))
        if count % _PROGRESS_EVERY == 0:
            on_progress(count)
    for kind, what in ((LaserScan, "scans (/scan)"), (WheelOdometry, "odometry (/odom)")):
        if kind not in seen:
            raise RunError(f"{path}: holds no {what}: a calibration compares both")


def known_track(logs: Sequence[Path]) -> float:
    """The track width that all logs name, m; 0 where one does not."""
    named = set()
    for path in logs:
        with open_log(path) as log:
            named.add(log.metadata().get("run", {}).get(TRACK, ""))
    try:
        return float(named.pop()) if len(named) == 1 else 0.0
    except ValueError:  # nothing is said, or no number
        return 0.0


def described(found: Calibration) -> Iterator[str]:
    """The result in lines."""
    yield (
        f"{found.intervals} pieces of the drive compared, {found.metres:.0f} m and "
        f"{math.degrees(found.radians):.0f} deg; {found.unmatched} more not determined by the scans"
    )
    if found.intervals < LEAST_INTERVALS:
        yield (
            f"  all refused: {LEAST_INTERVALS} pieces are needed; drive a few minutes, straight "
            "and turning on the spot both ways, where walls are in view all round"
        )
        return
    for one in found.found:
        yield from _line(one)
    if found.wheels:
        yield f"wheels, for an odometry computed with a track of {found.track_m:g} m"
        for one in found.wheels:
            yield from _line(one)
    if found.noise:
        yield "random errors of the odometry"
        for one in found.noise:
            yield f"  {one.name:<18} {_pm(one)}"


def _line(one: Found) -> Iterator[str]:
    if one.refused:
        yield f"  {one.name:<18} refused: {one.refused}"
        yield f"  {'':<18} to see it: {one.drive}"
        return
    stated = "" if one.stated is None else f"  stated {_number(one.stated, one.sigma)}"
    if one.off > _SURE:
        stated += f", off by {one.off:.0f} sigma"
    yield f"  {one.name:<18} {_pm(one):<26}{stated}"


def _pm(one: Found) -> str:
    value, sigma = (_number(number, one.sigma) for number in (one.value, one.sigma))
    return f"{value} +- {sigma} {one.unit}".rstrip()


def _number(value: float, sigma: float) -> str:
    """As many digits as the sigma is worth."""
    digits = max(0, 1 - math.floor(math.log10(sigma))) if sigma > 0.0 else _DIGITS
    return f"{value:.{min(digits, _DIGITS)}f}"


def as_toml(found: Calibration, sources: Sequence[str]) -> str:
    """A file for `slam replay --calibration`, whose table robot.toml takes as well.

    Sigmas, and what was refused, are comments.
    """
    lines = [f"# slam calibrate {' '.join(map(shown, sources))}", "[calibration]"]
    values = found.as_config().model_dump(exclude_none=True)
    for one in found.found:
        if one.refused:
            lines.append(f"# {one.name} refused: {one.refused}; {one.drive}")
        else:
            sigma = f"sigma {_number(one.sigma, one.sigma)} {one.unit}".rstrip()
            lines.append(f"{one.name} = {values[one.name]}  # {sigma}")
    if found.track_m:
        lines.append(f"{TRACK} = {found.track_m}")
    for one in (*found.wheels, *found.noise):
        lines.append(f"# {one.name}: {_pm(one)}")
    return "\n".join(lines) + "\n"


def write_calibration(found: Calibration, sources: Sequence[Path], out: Path) -> None:
    """Write `as_toml`.

    Raises:
        RunError: the file cannot be written.
    """
    try:
        atomic_write(out, as_toml(found, [path.name for path in sources]))
    except OSError as error:
        raise RunError(f"{out}: cannot be written: {error.strerror}") from error
