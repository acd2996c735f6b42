"""A range finder: what it would measure in a world, with its noise and its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
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

    def __post_init__(self) -> None:
        """Refuse a range finder that could not be built."""
        if self.beams < 1 or self.angle_step == 0.0 or self.rate_hz <= 0.0:
            raise ValueError("a laser needs beams, an angle between them and a rate")
        if abs(self.angle_step) * (self.beams - 1) > 2.0 * np.pi + 1e-9:
            raise ValueError("a sweep spans one turn at most")
        if not 0.0 <= self.range_min < self.range_max or not 0.0 <= self.dropout <= 1.0:
            raise ValueError("need 0 <= range_min < range_max, and a dropout between 0 and 1")
        if self.sigma < 0.0 or self.quantum < 0.0:
            raise ValueError("sigma and quantum cannot be negative")
        if not 0.0 <= self.beam_period_s * self.beams <= 1.0 / self.rate_hz:
            raise ValueError("a sweep must end before the next one begins")

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
    }
)


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
