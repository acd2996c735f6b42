"""A range finder: what it would measure in a world, with its noise and its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians, tau
from types import MappingProxyType

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.world import World
from slam.logs.messages import LaserScan

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class LaserConfig:
    """Geometry, timing and faults of a range finder."""

    beams: int  # readings in a sweep
    angle_min: float  # rad, bearing of the first beam
    angle_step: float  # rad, negative for a laser that turns clockwise
    range_min: float = 0.02  # m, nearer is no measurement and reads nan
    range_max: float = 30.0  # m, farther brings nothing back and reads inf
    rate_hz: float = 10.0  # sweeps a second
    sigma: float = 0.010  # m, noise of a range; the paper experiment's 10 mm
    quantum: float = 0.001  # m, steps in which ranges are reported, 0 for none
    dropout: float = 0.0  # share of beams that bring nothing back for no reason
    beam_period_s: float = 0.0  # s from beam to beam; over 0 bends a sweep taken on the move
    sigma_share: float = 0.0  # of the range, noise that grows with it
    spare_beams: int = 0  # up to so many fewer readings in a sweep: motors do not turn evenly

    def __post_init__(self) -> None:
        """Refuse a range finder that could not be built."""
        if self.beams < 1 or self.angle_step == 0.0 or self.rate_hz <= 0.0:
            raise ValueError("a laser needs beams, an angle between them and a rate")
        if abs(self.angle_step) * (self.beams - 1) > 2.0 * np.pi + 1e-9:
            raise ValueError("a sweep spans one turn at most")
        if not 0.0 <= self.range_min < self.range_max or not 0.0 <= self.dropout <= 1.0:
            raise ValueError("need 0 <= range_min < range_max, and a dropout between 0 and 1")
        if min(self.sigma, self.sigma_share, self.quantum) < 0.0:
            raise ValueError("noise and quantum cannot be negative")
        if not 0 <= self.spare_beams < self.beams:
            raise ValueError("some beams must be left in a sweep")
        if not 0.0 <= self.beam_period_s * self.beams <= 1.0 / self.rate_hz:
            raise ValueError("a sweep must end before the next one begins")

    def sweep(self, rng: np.random.Generator) -> LaserConfig:
        """The laser in its next sweep, whose readings lie closer or wider over the same view."""
        if not self.spare_beams:
            return self
        beams = self.beams - int(rng.integers(self.spare_beams + 1))
        wider = self.beams / beams
        return replace(
            self, beams=beams, spare_beams=0, angle_step=self.angle_step * wider,
            beam_period_s=self.beam_period_s * wider,
        )  # fmt: skip

    @property
    def bearings(self) -> Array:
        """The direction of every beam in the laser frame, (beams,) rad."""
        return self.angle_min + self.angle_step * np.arange(self.beams, dtype=np.float64)


# Ranges and steps after docs/devices.md, section 4.2, unless a comment says otherwise.
LASERS: Mapping[str, LaserConfig] = MappingProxyType(
    {
        # The paper's: a UTM-30LX read in clusters of four steps, three sweeps of four skipped.
        "hokuyo-181": LaserConfig(beams=181, angle_min=radians(-90.0), angle_step=radians(1.0)),
        # 1440 steps a turn at 2400 rpm: 17.4 us from beam to beam for those who set it.
        "utm-30lx": LaserConfig(
            beams=1081, angle_min=radians(-135.0), angle_step=radians(0.25), rate_hz=40.0
        ),
        # SICK LMS 200 at half a degree in centimetres: 80 m, 37.5 sweeps a second (its manual).
        "sick-361": LaserConfig(
            beams=361,
            angle_min=radians(-90.0),
            angle_step=radians(0.5),
            range_max=80.0,
            rate_hz=37.5,
            quantum=0.01,
        ),
        # Steps 44 to 725 of 1024 with 384 ahead; beyond 4.095 m its short codes end.
        "urg-04lx": LaserConfig(
            beams=682,
            angle_min=-340 * 2.0 * np.pi / 1024,
            angle_step=2.0 * np.pi / 1024,
            range_max=4.095,
        ),
        # LDS-01 of the TurtleBot 3: a turn in 0.2 s.  Its sheet allows 15 mm below 0.5 m and 5 %
        # beyond, with 3.5 % of repeats: read here as noise of a third of that.
        "lds-01": LaserConfig(
            beams=360, angle_min=0.0, angle_step=tau / 360, range_min=0.12, range_max=3.5,
            rate_hz=5.0, sigma=0.005, sigma_share=0.012, beam_period_s=0.2 / 361,
        ),
        # RPLidar A1: 8000 readings a second at 5.5 to 10 Hz, 12 m; 1 % of the range up to 3 m and
        # 2 % up to 5 m are its limits of error.  It counts clockwise.
        "rplidar-a1": LaserConfig(
            beams=1000, angle_min=tau / 2, angle_step=-tau / 1000, range_min=0.15, range_max=12.0,
            rate_hz=8.0, sigma=0.004, sigma_share=0.004, quantum=0.00025, dropout=0.02,
            beam_period_s=0.125 / 1001, spare_beams=30,
        ),
        # LD06 of LDRobot: 4500 readings a second, 10 Hz, so now 455 and now 456 of them; 12 m,
        # 10 mm of spread by its sheet.  It counts clockwise.
        "ld06": LaserConfig(
            beams=456, angle_min=tau / 2, angle_step=-tau / 456, range_max=12.0, rate_hz=9.87,
            sigma=0.01, beam_period_s=1.0 / 4500 - 1e-7, spare_beams=1,
        ),
    }
)  # fmt: skip


def take_scan(
    world: World,
    world_T_laser: Pose2,
    laser: LaserConfig,
    rng: np.random.Generator,
    stamp_ns: int = 0,
) -> LaserScan:
    """Measure one sweep of a laser at rest."""
    exact = world.cast(world_T_laser, laser.bearings, laser.range_max)
    return _reported(exact, laser, rng, stamp_ns)


def take_moving_scan(
    world: World,
    world_T_lasers: Array,
    laser: LaserConfig,
    rng: np.random.Generator,
    stamp_ns: int = 0,
) -> LaserScan:
    """Measure one sweep of a laser on the move, beam i from row i of (beams, 3) x, y, theta."""
    exact = world.cast_moving(world_T_lasers, laser.bearings, laser.range_max)
    return _reported(exact, laser, rng, stamp_ns)


def _reported(
    exact: Array, laser: LaserConfig, rng: np.random.Generator, stamp_ns: int
) -> LaserScan:
    """Add noise, dropouts, rounding and limits to (n,) exact ranges.

    The same numbers are drawn whatever the beams meet, so that a change of the world does
    not change the noise of later sweeps.
    """
    noise, luck = rng.standard_normal(len(exact)), rng.random(len(exact))
    ranges = exact + laser.sigma * noise
    if laser.sigma_share > 0.0:
        sigmas = np.hypot(laser.sigma, laser.sigma_share * np.where(np.isfinite(exact), exact, 0.0))
        ranges = exact + sigmas * noise
    if laser.quantum > 0.0:
        ranges = np.round(ranges / laser.quantum) * laser.quantum
    ranges[ranges > laser.range_max] = np.inf
    ranges[ranges < laser.range_min] = np.nan
    ranges[luck < laser.dropout] = np.inf
    return LaserScan(
        stamp_ns=stamp_ns,
        angle_min=laser.angle_min,
        angle_step=laser.angle_step,
        ranges=ranges.astype(np.float32),
        range_min=laser.range_min,
        range_max=laser.range_max,
        beam_period_s=laser.beam_period_s,
    )
