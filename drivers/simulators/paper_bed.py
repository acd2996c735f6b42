"""The seed paper's test bed (Figure 5): a corridor with boards of varied depth on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.outlines import polyline
from slam.drivers.simulators.world import World

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class BedConfig:
    """The paper shows the bed but does not measure it: these are our reading of the figure."""

    width: float = 2.0  # m between the plain walls
    board_min: float = 0.2  # m, shortest board along the wall
    board_max: float = 0.6  # m, longest
    depth_max: float = 0.3  # m, how far a board stands out from the wall
    bare: float = 0.25  # share of places without a board
    behind: float = 1.0  # m of bed behind the start
    beyond: float = 1.5  # m of bed beyond the end point
    ahead: float = 25.0  # m from the start to the end of the plain walls
    end_wall: bool = True  # the corridor is closed there

    def __post_init__(self) -> None:
        """Keep the lane free and the boards of a possible size."""
        if not 0.0 < self.board_min <= self.board_max or not 0.0 <= self.bare <= 1.0:
            raise ValueError("need 0 < board_min <= board_max and a share of bare wall up to 1")
        if self.depth_max < 0.0 or 0.5 * self.width - self.depth_max < 0.4:
            raise ValueError("the boards leave the robot less than 0.4 m to each side")


def paper_bed(length: float, config: BedConfig, rng: np.random.Generator) -> World:
    """Build the bed for a drive of `length` metres along x from (0, 0)."""
    if config.ahead < length + config.beyond + config.board_max:
        raise ValueError(f"a drive of {length} m does not fit into {config.ahead} m of corridor")
    sides = [_side(length + config.beyond, side, config, rng) for side in (1.0, -1.0)]
    back = [polyline([sides[0][0], sides[1][0]])]
    end = [polyline([sides[0][-1], sides[1][-1]])] if config.end_wall else []
    return World(np.vstack([polyline(sides[0]), polyline(sides[1]), *back, *end]))


def _side(until: float, side: float, config: BedConfig, rng: np.random.Generator) -> Array:
    """Return the corners of the left (side 1) or right (side -1) wall, in order of x."""
    x, wall = -config.behind, side * 0.5 * config.width
    corners = [(x, wall)]
    while x < until:
        depth = 0.0 if rng.random() < config.bare else rng.uniform(0.0, config.depth_max)
        face = wall - side * depth
        corners.append((x, face))
        x += rng.uniform(config.board_min, config.board_max)
        corners.append((x, face))
    corners += [(x, wall), (config.ahead, wall)]
    return np.array(corners)
