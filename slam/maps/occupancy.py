"""Occupancy grid from scans at known poses.

Log-odds mapping after Moravec & Elfes 1985 and Thrun et al., "Probabilistic Robotics",
chapter 9, with one refinement that keeps thin walls: a scan changes a cell once at most, and
a hit wins over a beam that merely grazes the cell on its way.  Integer log-odds make the
result independent of rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from slam.frontend.compiled import allocating_part, kernel, part
from slam.logs.messages import LaserScan, OccupancyMap
from slam.logs.trajectory import Poses

# A cell is 15 bits of log-odds in steps of 1/1000 about CENTRE, 0 where never seen, and one
# bit that marks it as changed by the scan in hand.
_CENTRE = 1 << 14
_MARK = 1 << 15
_SCALE = 1000.0
_FRACTION_BITS = 32  # of a cell, when walking along a beam
_BLOCK = 1024  # scans flattened at a time, so that memory does not grow with the log


class MapConfig(BaseModel):
    """How the occupancy map is drawn."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    resolution: float = Field(default=0.05, ge=0.001, le=10, description="m per cell")
    max_range: float = Field(
        default=30.0,
        gt=0,
        le=1000,
        description="m; longer beams clear the way so far and hit nothing",
    )
    no_return_free: float = Field(
        default=2.0,
        ge=0,
        le=1000,
        description="m that a beam without return clears; far less than the sensor's reach, "
        "because glass and black walls return nothing either",
    )
    hit_probability: float = Field(
        default=0.7, gt=0.5, lt=1, description="that a cell is occupied, given one hit"
    )
    miss_probability: float = Field(
        default=0.4, gt=0, lt=0.5, description="that a cell is occupied, given one passing beam"
    )
    clamp_probability: float = Field(
        default=0.98, gt=0.5, lt=1, description="certainty beyond which a cell learns no more"
    )
    margin: float = Field(default=0.5, ge=0, le=100, description="m of unknown left around the map")
    max_cells: int = Field(
        default=64_000_000,
        gt=0,
        le=500_000_000,
        description="bound on memory (2 bytes each); a larger map is cropped around its middle",
    )


@dataclass(frozen=True, slots=True)
class _Extent:
    """The cells of a grid, as whole multiples of the resolution in the map frame."""

    left: int
    bottom: int
    columns: int
    rows: int


class _Beams(NamedTuple):
    """Scans laid end to end: beams `first[i]` to `first[i + 1]` belong to scan i."""

    ranges: NDArray[np.float32]
    first: NDArray[np.int64]
    angles: NDArray[np.float64]  # (n, 2) rad: start and step
    limits: NDArray[np.float64]  # (n, 2) m: nearest and farthest measurement
    poses: Poses  # (n, 3) map_T_laser


class _Rules(NamedTuple):
    """The configuration as the kernel needs it."""

    resolution: float
    max_range: float
    no_return_free: float
    hit: int  # integer log-odds
    miss: int
    clamp: int


def build_map(
    scans: Sequence[LaserScan],
    map_T_laser: Poses,
    config: MapConfig | None = None,
    stamp_ns: int | None = None,
) -> OccupancyMap:
    """Draw the map that the scans make at their poses (n, 3), `map_T_laser`.

    Beams of nan, and readings nearer than the sensor can see, say nothing; inf clears the
    first `no_return_free` metres.  A scan whose pose is not finite is left out.  The stamp is
    that of the last scan unless given.

    Raises:
        ValueError: if there are not as many poses as scans.
    """
    config = config or MapConfig()
    if map_T_laser.shape != (len(scans), 3):
        raise ValueError(
            f"{len(scans)} scans need ({len(scans)}, 3) poses, got {map_T_laser.shape}"
        )
    if stamp_ns is None:
        stamp_ns = scans[-1].stamp_ns if len(scans) else 0
    rules = _rules(config)
    blocks = [slice(i, i + _BLOCK) for i in range(0, len(scans), _BLOCK)]
    bounds = np.array([math.inf, math.inf, -math.inf, -math.inf])
    for block in blocks:
        _grow_bounds(_beams(scans[block], map_T_laser[block]), rules, bounds)
    extent = _extent(bounds, map_T_laser, config)
    cells = np.zeros((extent.rows, extent.columns), dtype=np.uint16)
    for block in blocks:
        beams = _beams(scans[block], map_T_laser[block])
        _draw(beams, rules, cells, extent.left, extent.bottom)
    return OccupancyMap(
        stamp_ns=stamp_ns,
        resolution=config.resolution,
        origin_x=extent.left * config.resolution,
        origin_y=extent.bottom * config.resolution,
        cells=_to_percent(cells),
    )


def _beams(scans: Sequence[LaserScan], poses: Poses) -> _Beams:
    first = np.zeros(len(scans) + 1, dtype=np.int64)
    np.cumsum([len(scan.ranges) for scan in scans], out=first[1:])
    return _Beams(
        np.concatenate([scan.ranges for scan in scans]).astype(np.float32, copy=False),
        first,
        np.array([(scan.angle_min, scan.angle_step) for scan in scans], dtype=np.float64),
        np.array([(scan.range_min, scan.range_max) for scan in scans], dtype=np.float64),
        np.ascontiguousarray(poses, dtype=np.float64),
    )


def _extent(bounds: NDArray[np.float64], poses: Poses, config: MapConfig) -> _Extent:
    """Return the grid that holds the bounds (x, y low; x, y high), cropped to `max_cells`."""
    if not np.all(np.isfinite(bounds)):
        return _Extent(0, 0, 1, 1)
    if (
        np.prod((bounds[2:] - bounds[:2] + 2 * config.margin) / config.resolution)
        > config.max_cells
    ):
        bounds = _crop(bounds, poses, config)
    low = np.floor((bounds[:2] - config.margin) / config.resolution).astype(np.int64)
    high = np.ceil((bounds[2:] + config.margin) / config.resolution).astype(np.int64)
    columns, rows = (np.maximum(high - low, 1)).tolist()
    return _Extent(int(low[0]), int(low[1]), columns, rows)


def _crop(bounds: NDArray[np.float64], poses: Poses, config: MapConfig) -> NDArray[np.float64]:
    """Drop stray poses first; if the place itself is too large, keep a square in its middle."""
    finite = poses[np.all(np.isfinite(poses), axis=1)]
    low, high = np.percentile(finite[:, :2], [1.0, 99.0], axis=0)
    cropped = np.concatenate(
        [
            np.maximum(bounds[:2], low - config.max_range),
            np.minimum(bounds[2:], high + config.max_range),
        ]
    )
    side = (
        math.sqrt(config.max_cells) * config.resolution - 2 * config.margin - 2 * config.resolution
    )
    size = cropped[2:] - cropped[:2] + 2 * config.margin
    if np.prod(size / config.resolution + 2) > config.max_cells:
        middle = np.median(finite[:, :2], axis=0)
        half = max(side / 2.0, config.resolution)
        cropped = np.concatenate([middle - half, middle + half])
    return cropped


def _rules(config: MapConfig) -> _Rules:
    probabilities = (config.hit_probability, config.miss_probability, config.clamp_probability)
    hit, miss, clamp = (round(math.log(p / (1.0 - p)) * _SCALE) for p in probabilities)
    return _Rules(config.resolution, config.max_range, config.no_return_free, hit, miss, clamp)


def _to_percent(cells: NDArray[np.uint16]) -> NDArray[np.int8]:
    """Turn log-odds into percent through a table; never-seen cells become -1."""
    log_odds = (np.arange(_MARK) - _CENTRE) / _SCALE
    table = np.round(100.0 / (1.0 + np.exp(-log_odds))).astype(np.int8)
    table[0] = -1
    return table[cells]


@part
def _reach(reading, nearest, farthest, rules):
    """Return how far a beam clears (negative: it says nothing) and whether it hit something."""
    if math.isnan(reading) or reading <= 0.0 or reading < nearest:
        return -1.0, False
    if math.isinf(reading) or reading > farthest:
        return min(rules.no_return_free, rules.max_range), False
    if reading > rules.max_range:
        return rules.max_range, False
    return reading, True


@part
def _find_ends(beams, rules, scan, ends, hits):
    """Write where each beam of a scan ends (m, map frame; nan: says nothing) and if it hit."""
    x, y, theta = beams.poses[scan]
    first = beams.first[scan]
    angle_min, angle_step = beams.angles[scan]
    nearest, farthest = beams.limits[scan]
    for k in range(beams.first[scan + 1] - first):
        reach, hits[k] = _reach(beams.ranges[first + k], nearest, farthest, rules)
        angle = theta + angle_min + k * angle_step
        ends[k, 0] = x + reach * math.cos(angle) if reach > 0.0 else math.nan
        ends[k, 1] = y + reach * math.sin(angle)


@part
def _most_beams(beams):
    most = 0
    for scan in range(len(beams.first) - 1):
        most = max(most, beams.first[scan + 1] - beams.first[scan])
    return most


@kernel
def _grow_bounds(beams, rules, bounds):
    """Widen bounds (x, y low; x, y high) to hold every pose and the end of every beam."""
    most = _most_beams(beams)
    ends, hits = np.empty((most, 2)), np.empty(most, dtype=np.bool_)
    for scan in range(len(beams.first) - 1):
        x, y, theta = beams.poses[scan]
        if not math.isfinite(x + y + theta):
            continue
        bounds[0], bounds[1] = min(bounds[0], x), min(bounds[1], y)
        bounds[2], bounds[3] = max(bounds[2], x), max(bounds[3], y)
        _find_ends(beams, rules, scan, ends, hits)
        for k in range(beams.first[scan + 1] - beams.first[scan]):
            if not math.isnan(ends[k, 0]):
                bounds[0], bounds[1] = min(bounds[0], ends[k, 0]), min(bounds[1], ends[k, 1])
                bounds[2], bounds[3] = max(bounds[2], ends[k, 0]), max(bounds[3], ends[k, 1])


@kernel
def _draw(beams, rules, cells, left, bottom):
    """Add scans to the grid, each in two sweeps: hits first, so that they win, then the ways."""
    rows, columns = cells.shape
    most = _most_beams(beams)
    ends, hits = np.empty((most, 2)), np.empty(most, dtype=np.bool_)
    # A beam takes one cell per step along its longer axis, so a scan changes no more than:
    longest = int(max(rules.max_range, rules.no_return_free) / rules.resolution) + 3
    touched = np.empty(min(most * longest, rows * columns), dtype=np.int64)
    reach = rules.max_range + rules.resolution
    for scan in range(len(beams.first) - 1):
        x, y, theta = beams.poses[scan]
        # A far stray pose cannot change the grid, and would overflow the walk's integers.
        near = -reach < x - left * rules.resolution < columns * rules.resolution + reach
        near &= -reach < y - bottom * rules.resolution < rows * rules.resolution + reach
        if near and math.isfinite(theta):
            _find_ends(beams, rules, scan, ends, hits)
            _draw_scan(
                beams.first[scan + 1] - beams.first[scan],
                x / rules.resolution - left,
                y / rules.resolution - bottom,
                ends / rules.resolution - np.array([left, bottom]),
                hits,
                rules,
                cells,
                touched,
            )


@allocating_part
def _draw_scan(beams, x, y, ends, hits, rules, cells, touched):
    """Draw one scan of `beams` beams; positions are in cells from the grid's corner."""
    rows, columns = cells.shape
    flat = cells.reshape(-1)
    count = np.int64(0)  # a plain 0 would be a type of its own, and what follows compile twice
    for k in range(beams):
        if hits[k]:
            column, row = math.floor(ends[k, 0]), math.floor(ends[k, 1])
            if 0 <= column < columns and 0 <= row < rows:
                index = row * columns + column
                count = _change(flat, index, rules.hit, rules.clamp, touched, count)
    for k in range(beams):
        if not math.isnan(ends[k, 0]):
            count = _clear(flat, rows, columns, x, y, ends[k], rules, touched, count)
    for k in range(count):
        flat[touched[k]] &= _MARK - 1


@part
def _change(flat, index, step, clamp, touched, count):
    """Add a step to a cell unless this scan already did; returns the count of touched cells."""
    value = np.int64(flat[index])
    if value & _MARK:
        return count
    log_odds = (value - _CENTRE if value else 0) + step
    log_odds = min(max(log_odds, -clamp), clamp)
    flat[index] = (log_odds + _CENTRE) | _MARK
    touched[count] = index
    return count + 1


@part
def _clear(flat, rows, columns, x, y, end, rules, touched, count):
    """Lower the cells from (x, y) to `end` (in cells), one per step along the longer axis."""
    dx, dy = end[0] - x, end[1] - y
    n = math.ceil(max(abs(dx), abs(dy)))
    if n == 0:
        return count
    one = 1 << _FRACTION_BITS
    column, row = np.int64(x * one), np.int64(y * one)
    step_column, step_row = np.int64(dx / n * one), np.int64(dy / n * one)
    inside = 0 <= x < columns and 0 <= y < rows and 0 <= end[0] < columns and 0 <= end[1] < rows
    for _ in range(n):
        c, r = column >> _FRACTION_BITS, row >> _FRACTION_BITS
        if inside or (0 <= c < columns and 0 <= r < rows):
            count = _change(flat, r * columns + c, rules.miss, rules.clamp, touched, count)
        column += step_column
        row += step_row
    return count
