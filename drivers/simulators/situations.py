"""Situations that make a map go wrong, each by a name and a seed, with the trait and without."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from slam.drivers.simulators.buildings import office, office_ring
from slam.drivers.simulators.corridors import Plan
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LaserConfig
from slam.drivers.simulators.open_places import (
    courtyard,
    grove,
    long_loop,
    posts_corridor,
    wide_hall,
)
from slam.drivers.simulators.path import MotionConfig
from slam.drivers.simulators.robot import ODOMETRY_NOISE, OdometryNoise
from slam.drivers.simulators.traits import (
    Person,
    with_creeping_heading,
    with_heavy_tails,
    with_nothing_code,
    with_people,
    with_sparse_scans,
    with_stale_odometry,
)
from slam.drivers.simulators.worlds import Scenario
from slam.logs.messages import SensorMessage

Trait = Callable[[Iterator[SensorMessage], int], Iterator[SensorMessage]]  # messages, seed

HALF_TURN = LaserConfig(beams=181, angle_min=-0.5 * math.pi, angle_step=math.pi / 180.0)
FULL_TURN = LaserConfig(beams=360, angle_min=-math.pi, angle_step=math.pi / 180.0)
GOOD_WHEELS = OdometryNoise(  # 7 mm and 0.07 degrees a keyframe step: better than most matches
    distance_scale=0.002, turn_scale=0.002, drift=0.0003,
    distance_random=0.007, turn_random=0.002, heading_random=0.0015,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Situation:
    """A drive and what is odd about it.

    The trait is a change of the messages, or another laser or place: `without` says what stands
    in for it where the trait is left out.
    """

    plan: Callable[[np.random.Generator], Plan]
    laser: LaserConfig = HALF_TURN
    noise: OdometryNoise = ODOMETRY_NOISE["typical"]
    motion: MotionConfig = field(default_factory=MotionConfig)
    trait: Trait | None = None
    without: Mapping[str, object] = field(default_factory=dict)  # fields replaced without the trait


def situation_drive(name: str, seed: int, with_trait: bool = True) -> Iterator[SensorMessage]:
    """The messages of a situation, in stamp order, with the truth.

    Raises:
        ValueError: no situation has that name.
    """
    if name not in SITUATIONS:
        raise ValueError(f"unknown situation {name!r}, known are {', '.join(SITUATIONS)}")
    situation = SITUATIONS[name]
    if not with_trait:
        situation = replace(situation, trait=None, **situation.without)  # type: ignore[arg-type]
    world, path = situation.plan(np.random.default_rng(seed))
    messages = simulate(
        Scenario(name, world, path), situation.laser, situation.noise, seed, motion=situation.motion
    )
    return situation.trait(messages, seed) if situation.trait else messages


def _people(*people: Person) -> Trait:
    return lambda messages, seed: with_people(messages, people, seed)


def _coded(code: float, share: float) -> Trait:
    return lambda messages, seed: with_nothing_code(messages, code, share, seed)


def _sparse(spacing_m: float, spacing_s: float) -> Trait:
    return lambda messages, seed: with_sparse_scans(messages, spacing_m, spacing_s)


def _stale(share: float) -> Trait:
    return lambda messages, seed: with_stale_odometry(messages, share, seed)


_short = replace(FULL_TURN, range_max=6.0)
_hall = partial(Situation, plan=wide_hall, laser=_short)
_posts = partial(Situation, laser=FULL_TURN, motion=MotionConfig(speed=0.5))
_grove = partial(Situation, plan=grove(18), trait=_sparse(0.3, 0.6))
_bent = replace(FULL_TURN, rate_hz=5.0, beam_period_s=0.2 / 360)
_behind, _beside, _ahead = Person(-0.9, 0.0), Person(0.0, 0.9), Person(1.2, 0.2)
_sideways = Person(-0.6, -0.8)


def _post_row(pitch: float, rate_hz: float, jitter: float = 0.0) -> Situation:
    """Without the trait: the same posts where no two gaps are equal."""
    return _posts(
        plan=posts_corridor(pitch, jitter=jitter),
        laser=replace(FULL_TURN, rate_hz=rate_hz),
        without={"plan": posts_corridor(pitch, jitter=0.15 * pitch)},
    )


SITUATIONS: Mapping[str, Situation] = MappingProxyType(
    {
        "person-behind": _hall(trait=_people(_behind)),
        "person-beside": _hall(trait=_people(_beside)),
        "person-ahead": _hall(trait=_people(_ahead)),
        "three-people": _hall(trait=_people(_behind, _sideways, _beside)),
        "nothing-code": _hall(
            laser=replace(FULL_TURN, range_max=3.5), trait=_coded(3.496, 1.0)
        ),
        "nothing-code-office": Situation(
            plan=office, laser=replace(FULL_TURN, range_max=3.5), trait=_coded(3.496, 0.22)
        ),
        "posts-0.36": _post_row(0.36, 2.5),
        "posts-0.36-10hz": _post_row(0.36, 10.0),
        "posts-0.50": _post_row(0.50, 2.5),
        "posts-0.70": _post_row(0.70, 2.5),
        "bent-sweep": Situation(
            plan=office_ring, laser=_bent, motion=MotionConfig(speed=0.7, turn_rate=1.5),
            without={"laser": replace(_bent, beam_period_s=0.0)},
        ),
        "grove-20m": _grove(laser=replace(HALF_TURN, range_max=20.0)),
        "grove-8m": _grove(laser=replace(HALF_TURN, range_max=8.0)),
        "grove-good-wheels": _grove(noise=GOOD_WHEELS),
        "courtyard": Situation(plan=courtyard, trait=_sparse(0.2, 0.6), noise=GOOD_WHEELS),
        "sparse-1m": Situation(plan=office_ring, trait=_sparse(1.0, 0.0)),
        "sparse-0.5m": Situation(plan=office_ring, trait=_sparse(0.5, 0.0)),
        "heavy-tails": Situation(
            plan=office_ring, trait=lambda messages, seed: with_heavy_tails(messages, seed)
        ),
        "stale-odometry": Situation(plan=office_ring, trait=_stale(0.002)),
        "creeping-heading": Situation(
            plan=office_ring, motion=MotionConfig(rest_s=60.0),
            trait=lambda messages, seed: with_creeping_heading(messages, math.radians(0.2)),
        ),
        "noise-5cm": Situation(
            plan=office_ring, laser=replace(HALF_TURN, sigma=0.05), without={"laser": HALF_TURN}
        ),
        "long-loop": Situation(
            plan=long_loop(125.0), laser=replace(HALF_TURN, rate_hz=2.0),
            motion=MotionConfig(speed=0.9), without={"noise": GOOD_WHEELS},
        ),
    }
)  # fmt: skip
