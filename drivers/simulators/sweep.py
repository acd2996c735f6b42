"""What a simulated Hokuyo measures: sweeps of a world, in the sensor's numbers."""

from __future__ import annotations

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.scip_scan import ScanRequest, encode_scan
from slam.drivers.simulators.drive import BASE_T_LASER
from slam.drivers.simulators.hokuyo_models import HokuyoModel
from slam.drivers.simulators.laser import LaserConfig, take_moving_scan, take_scan
from slam.drivers.simulators.motion import Motion
from slam.drivers.simulators.world import World

Integers = NDArray[np.int32]
_NOT_MEASURABLE = 19  # code of steps outside AMIN to AMAX (section 4.5)


class Sweeper:
    """A sensor head on a robot: measures the steps of one sweep and codes them.

    Equal seeds and sweeps give equal numbers, whichever sweeps were asked for before.
    """

    def __init__(
        self,
        model: HokuyoModel,
        world: World,
        motion: Motion,
        *,
        base_T_laser: Pose2 = BASE_T_LASER,
        sigma_m: float = 0.010,
        bends: bool = False,
        seed: int = 0,
    ) -> None:
        """With `bends`, each step is measured where the robot is at its own time (slower)."""
        self.model = model
        self._world, self._motion, self._base_T_laser = world, motion, base_T_laser
        self._sigma_m, self._bends, self._seed = sigma_m, bends, seed

    def report(self, request: ScanRequest, starts_s: float, count: int) -> list[bytes]:
        """Return timestamp and data lines of the sweep that passes step 0 at `starts_s`."""
        distances = clustered(self.distances(request, starts_s), request.cluster)
        # No physics in it: bright nearby, and something to tell columns apart by.
        bright = (4000 - distances // 16).clip(0, 4095).astype(np.int32)
        intensities = bright if request.with_intensity else None
        return encode_scan(count, distances, request.characters, intensities)

    def distances(self, request: ScanRequest, starts_s: float) -> Integers:
        """Return mm or an error code for every step of the request, before clustering."""
        sensor = self.model.parameters
        laser = LaserConfig(
            beams=request.end - request.start + 1,
            angle_min=sensor.bearing(request.start),
            angle_step=sensor.step_rad,
            range_min=sensor.range_min_mm * 1e-3,
            range_max=self.model.reach_mm * 1e-3,
            rate_hz=sensor.rpm / 60.0,
            sigma=self._sigma_m,
            beam_period_s=sensor.step_s if self._bends else 0.0,
        )
        first_s = starts_s + request.start * sensor.step_s
        rng = np.random.default_rng([self._seed, round(starts_s * 1e6)])
        if self._bends:
            times = first_s + np.arange(laser.beams, dtype=np.float64) * np.float64(sensor.step_s)
            scan = take_moving_scan(self._world, self._lasers(times), laser, rng)
        else:
            pose = Pose2(*self._lasers(np.array([first_s]))[0].tolist())
            scan = take_scan(self._world, pose, laser, rng)
        metres = scan.ranges.astype(np.float64)
        codes = np.where(np.isinf(metres), self.model.nothing, self.model.too_near)
        measured = np.isfinite(metres)
        millimetres = np.round(np.where(measured, metres, 0.0) * 1000.0)
        steps = np.arange(request.start, request.end + 1)
        outside = (steps < sensor.first_step) | (steps > sensor.last_step)
        codes = np.where(outside, _NOT_MEASURABLE, codes)
        return np.asarray(np.where(measured & ~outside, millimetres, codes), np.int32)

    def _lasers(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the laser's poses in the world, (n, 3)."""
        x, y, theta = self._motion.truth(times_s).T
        ahead, left = self._base_T_laser.x(), self._base_T_laser.y()
        return np.column_stack(
            [
                x + ahead * np.cos(theta) - left * np.sin(theta),
                y + ahead * np.sin(theta) + left * np.cos(theta),
                theta + self._base_T_laser.theta(),
            ]
        )


def clustered(distances: Integers, cluster: int) -> Integers:
    """Join each `cluster` steps into the smallest of their ranges (docs/devices.md, section 4.2).

    Codes, which are below any range, count only where no step has a range.
    """
    if cluster <= 1:
        return distances
    missing = -len(distances) % cluster
    padded = np.pad(distances, (0, missing), constant_values=np.iinfo(np.int32).max)
    groups = padded.reshape(-1, cluster)
    is_range = groups > 19  # the largest code of any model
    nearest = np.where(is_range, groups, np.iinfo(np.int32).max).min(axis=1)
    none = nearest == np.iinfo(np.int32).max
    return np.asarray(np.where(none, groups[:, 0], nearest), np.int32)
