"""What drives show of a calibration, and what they do not show."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.calibration.derived import random_errors, wheel_sizes
from slam.evaluation.calibration.fit import Fit, fit_calibration
from slam.evaluation.calibration.intervals import DriveData, IntervalCollector
from slam.evaluation.calibration.model import OFFSET, YAW, Model
from slam.evaluation.calibration.unknowns import UNKNOWNS, Found, Unknown
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig
from slam.logs.messages import LaserExtrinsics, Message
from slam.mapping.calibration import CalibrationConfig

Array = NDArray[np.float64]

_DIGITS = 6  # of values in a file
NOTHING_KNOWN = CalibrationConfig()
LEAST_INTERVALS = 20  # three numbers each, for seven unknowns and nine of noise


@dataclass(frozen=True, eq=False, slots=True)
class Calibration:
    """All that one or several drives show."""

    found: tuple[Found, ...]  # the seven of `[calibration]`
    wheels: tuple[Found, ...]  # left and right scale, and track, where the track taken is known
    noise: tuple[Found, ...]  # of the odometry
    intervals: int
    unmatched: int
    metres: float  # compared
    radians: float
    track_m: float

    def as_config(self) -> CalibrationConfig:
        """What of it can be used, as settings."""
        used = [one for one in self.found if not one.refused]
        values = {one.name: round(one.value, _DIGITS) for one in used}
        return CalibrationConfig(
            **values,
            odometry_track_m=self.track_m,
        )


def calibrate_sources(
    sources: Sequence[Callable[[], Iterable[Message]]],
    matcher: MatchConfig,
    scan: ScanConfig,
    track_m: float = 0.0,
    known: CalibrationConfig = NOTHING_KNOWN,
) -> Calibration:
    """Calibrate from drives of one robot.

    Where scans carry their timing, the drives are read twice: what the first calibration finds
    takes the motion out of the sweeps for the second.

    Args:
        sources: each gives the messages of a drive, from the start, each time it is called.
        matcher: how scans are matched.
        scan: how they are prepared.
        track_m: the track width that the odometry was computed with; 0: unknown.
        known: the calibration to compare with.
    """

    def read(robot: CalibrationConfig) -> list[DriveData]:
        drives = []
        for source in sources:
            collector = IntervalCollector(matcher, scan, robot)
            for message in source():
                collector.feed(message)
            drives.append(collector.data())
        return drives

    drives = read(known)
    found = calibrate(drives, track_m, known)
    if not any(one.sweeps for one in drives):
        return found
    return calibrate(read(found.as_config()), track_m, known)


def stated_values(mount: LaserExtrinsics, known: CalibrationConfig = NOTHING_KNOWN) -> Array:
    """(7,) what counts for true: the mount of a log, and what is known of the robot besides."""
    at = known.mount(mount)
    return np.array(
        [
            at.x, at.y, at.theta, known.translation_scale, known.rotation_scale, known.curvature,
            known.time_offset_s,
        ]
    )  # fmt: skip


def calibrate(
    drives: Sequence[DriveData], track_m: float = 0.0, known: CalibrationConfig = NOTHING_KNOWN
) -> Calibration:
    """Calibrate from one drive, or several of one robot.

    Args:
        drives: as collected.
        track_m: the track width that the odometry was computed with; 0: unknown.
        known: the calibration to compare with.
    """
    usable = [one for one in drives if len(one.intervals) >= LEAST_INTERVALS]
    models = [Model.of(one, track_m) for one in usable]
    stated = stated_values((usable or drives)[0].stated, known)
    intervals, unmatched = (
        sum(len(one.intervals) for one in drives),
        sum(one.unmatched for one in drives),
    )
    if not models:
        few = "too few pieces of the drive show what the scans and the odometry saw"
        nothing = tuple(
            Found(u.name, u.unit, math.nan, math.inf, None, few, u.drive) for u in UNKNOWNS
        )
        return Calibration(nothing, (), (), intervals, unmatched, 0.0, 0.0, track_m)
    fits = [fit_calibration(model, stated) for model in models]
    values, covariance = combined(fits)
    paths = [model.paths() for model in models]
    metres, radians = (sum(float(path[k].sum()) for path in paths) for k in (0, 1))
    held = all(fit.offset_held for fit in fits)
    found = tuple(_judged(u, values, covariance, stated, (metres, radians), held) for u in UNKNOWNS)
    wheels = wheel_sizes(values, covariance, track_m) if track_m else ()
    noise = random_errors(max(fits, key=lambda fit: len(fit.weights)))
    return Calibration(found, wheels, noise, intervals, unmatched, metres, radians, track_m)


def combined(fits: Sequence[Fit]) -> tuple[Array, Array]:
    """(7,) and (7, 7) of several fits; wider where they contradict each other."""
    if len(fits) == 1:
        return fits[0].values, fits[0].covariance
    informations = [np.linalg.inv(fit.covariance) for fit in fits]
    covariance = np.linalg.inv(sum(informations))
    right = sum(i @ fit.values for i, fit in zip(informations, fits, strict=True))
    values = covariance @ right
    apart = sum(
        float((fit.values - values) @ i @ (fit.values - values))
        for i, fit in zip(informations, fits, strict=True)
    )
    return values, covariance * max(1.0, apart / (len(values) * (len(fits) - 1)))


def _judged(
    unknown: Unknown,
    values: Array,
    covariance: Array,
    stated: Array,
    path: tuple[float, float],
    held: bool,
) -> Found:
    k = unknown.index
    value = values[k] * unknown.per_unit
    before = stated[k] * unknown.per_unit
    if k == YAW:
        value = before + math.remainder(value - before, 360.0)
    sigma = math.sqrt(covariance[k, k]) * unknown.per_unit
    refused = ""
    if k == OFFSET and held:
        refused = "the odometry fits best with the stamps that it has; they jitter, or are right"
    elif sigma > unknown.useful:
        refused = (
            f"{unknown.why}; {path[0]:.0f} m and {math.degrees(path[1]):.0f} deg were compared, "
            f"which leave it open to {_short(sigma)} {unknown.unit}".rstrip()
        )
    return Found(unknown.name, unknown.unit, value, sigma, before, refused, unknown.drive)


def _short(value: float) -> str:
    return f"{value:.2g}"
