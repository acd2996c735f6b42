"""What a calibration predicts: by how much wheels and laser differ over each interval.

A base that moves by B carries a laser at M by L = M^-1 B M: the hand-eye equation, with which
Censi, Franchi, Marchionni and Oriolo (T-RO 2013) estimate wheels and mount together.  The time
offset is the time at which the odometry is read (Furgale, Rehder and Siegwart, IROS 2013).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import between, compose, logmap
from slam.evaluation.calibration.intervals import DriveData
from slam.evaluation.calibration.odometry_track import OdometryTrack
from slam.mapping.calibration import wheel_matrix

Array = NDArray[np.float64]

X, Y, YAW, TRANSLATION, ROTATION, CURVATURE, OFFSET = range(7)
NAMES = (
    "laser_x", "laser_y", "laser_yaw", "translation_scale", "rotation_scale", "curvature",
    "time_offset_s",
)  # fmt: skip
"""Of the unknowns: m, m, rad, 1, 1, rad/m, s."""
# Steps for derivatives by differences.  Between two readings of the odometry poses are
# interpolated: the step of the offset spans a part of that time, so that kinks even out.
_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-5, 1e-5, 0.02])


@dataclass(frozen=True, eq=False)
class Model:
    """Wheels and laser over n intervals."""

    track: OdometryTrack
    start_s: Array  # (n,)
    end_s: Array  # (n,)
    motions: Array  # (n, 3) of the laser, in its frame at the start
    covariances: Array  # (n, 3, 3) of them, in its frame at the end
    track_m: float = 0.0  # that the odometry was computed with; 0: unknown

    @classmethod
    def of(cls, data: DriveData, track_m: float = 0.0) -> Model:
        """The model of a drive."""
        found = data.intervals
        return cls(
            data.track, np.array([one.start_s for one in found]),
            np.array([one.end_s for one in found]),
            np.array([one.motion for one in found]).reshape(-1, 3),
            np.array([one.covariance for one in found]).reshape(-1, 3, 3), track_m,
        )  # fmt: skip

    def subset(self, chosen: Array | slice) -> Model:
        """The model of some of the intervals."""
        return Model(
            self.track, self.start_s[chosen], self.end_s[chosen], self.motions[chosen],
            self.covariances[chosen], self.track_m,
        )  # fmt: skip

    def residuals(self, values: Array) -> Array:
        """(n, 3): odometry less laser (forward m, left m, turn rad), in units of the odometry.

        Both steps are laid over each other in the middle of the interval (logarithm), where
        errors of the heading on the way have no part in those of the place.  In units of the
        odometry, whose errors are the larger by far: those of the laser, as the regressor, would
        draw the scales towards zero.
        """
        wheels = self.wheels(values)
        track = self.track.corrected(wheels)
        start, end = self.start_s - values[OFFSET], self.end_s - values[OFFSET]
        base = between(track.at(start), track.at(end))
        found = logmap(between(self.base_motions(values), base))
        inverse = np.linalg.inv(wheels)
        counted: Array = found / values[TRANSLATION]
        counted[:, [0, 2]] = found[:, [0, 2]] @ inverse.T
        return counted

    def wheels(self, values: Array) -> Array:
        """(2, 2): true (forward, turn) from those of the odometry."""
        translation, rotation, curvature = (
            float(values[k]) for k in (TRANSLATION, ROTATION, CURVATURE)
        )
        return wheel_matrix(translation, rotation, curvature, self.track_m)

    def base_motions(self, values: Array) -> Array:
        """(n, 3) steps of the base by the laser."""
        mount = values[[X, Y, YAW]]
        inverse = between(mount, np.zeros(3))
        return compose(compose(mount, self.motions), inverse)

    def match_covariances(self, values: Array) -> Array:
        """(n, 3, 3) errors of the matches as errors of the residuals."""
        cos, sin = np.cos(values[YAW]), np.sin(values[YAW])
        # A laser turned about itself moves the base sideways.
        adjoint = np.array([[cos, -sin, values[Y]], [sin, cos, -values[X]], [0.0, 0.0, 1.0]])
        scale = np.diag(1.0 / values[[TRANSLATION, TRANSLATION, ROTATION]])
        turned = scale @ adjoint
        rotated: Array = turned @ self.covariances @ turned.T
        return rotated

    def jacobian(self, values: Array) -> Array:
        """(n, 3, 7) of the residuals."""
        columns = []
        for k, step in enumerate(_STEPS):
            ahead, behind = values.copy(), values.copy()
            ahead[k] += step
            behind[k] -= step
            columns.append((self.residuals(ahead) - self.residuals(behind)) / (2.0 * step))
        return np.stack(columns, axis=2)

    def paths(self) -> tuple[Array, Array]:
        """(n,) m and (n,) rad of odometry along each interval."""
        way, turn = self.track.path
        times = self.track.times_s
        metres, radians = (
            np.interp(self.end_s, times, one) - np.interp(self.start_s, times, one)
            for one in (way, turn)
        )
        return metres, radians
