"""Named scenarios: a world whose geometry a seed varies, and a path to drive in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from slam.drivers.simulators.buildings import office, office_ring
from slam.drivers.simulators.calibration_room import calibration_room
from slam.drivers.simulators.corridors import (
    Plan,
    door_corridor,
    plain_corridor,
    symmetric_corridors,
)
from slam.drivers.simulators.halls import clutter, mixed
from slam.drivers.simulators.paper_bed import BedConfig, paper_bed
from slam.drivers.simulators.path import Leg
from slam.drivers.simulators.world import World


@dataclass(frozen=True, eq=False, slots=True)
class Scenario:
    """A place and a way through it, both in the world frame."""

    name: str
    world: World
    path: tuple[Leg, ...]


def _bed_drive(length: float) -> Callable[[np.random.Generator], Plan]:
    def plan(rng: np.random.Generator) -> Plan:
        return paper_bed(length, BedConfig(), rng), (Leg(((0.0, 0.0), (length, 0.0))),)

    return plan


_PLANS: Mapping[str, Callable[[np.random.Generator], Plan]] = MappingProxyType(
    {
        "testbed": _bed_drive(8.78),  # the seed paper's 462 steps of 1.9 cm
        "testbed-180cm": _bed_drive(1.80),  # its stated end point
        "plain-corridor": plain_corridor,
        "corridor": door_corridor,
        "office": office,
        "office-ring": office_ring,
        "symmetric-corridors": symmetric_corridors,
        "clutter": clutter,
        "mixed": mixed,
        "calibration-room": calibration_room,
    }
)
SCENARIOS: tuple[str, ...] = tuple(_PLANS)


def scenario(name: str, seed: int = 0) -> Scenario:
    """Build the scenario `name` with the geometry of `seed`.

    Raises:
        ValueError: if there is no scenario of that name.
    """
    if name not in _PLANS:
        raise ValueError(f"unknown scenario {name!r}, known are {', '.join(SCENARIOS)}")
    world, path = _PLANS[name](np.random.default_rng(seed))
    return Scenario(name, world, path)
