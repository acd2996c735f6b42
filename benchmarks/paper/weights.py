"""`slam bench weights`: where SDP-PE's weights come from, and whether they are worth it elsewhere.

From scans all along simulated drives, matches are made over a range of distances: what each is
off by is then known for any interval that a set of weights may choose there.  The weights are
those with which chained matches add the least variance a metre, with as many matches as a
constant interval of `MEAN_M`.  A corridor may be driven either way, so that left and right weigh
the same.  The limits of the interval are given, not fitted: simulated walls, with nobody about,
would have it ever longer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import Bounds, differential_evolution
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.frontend.complexity import wall_profiles, wall_sums
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from slam.mapping.odometry import OdometryConfig

Array = NDArray[np.float64]
Echo = Callable[[str], None]

TRAINING = ("testbed", "corridor", "mixed", "clutter")
OTHER = ("office", "plain-corridor")
SEEDS = {"training": (1000, 6), "fresh": (3000, 6), "other": (2000, 6)}  # first, number
QUICK_SEEDS = 1
DISTANCES_M = np.geomspace(0.1, 1.6, 9)
SPACING_M = {"testbed": 0.8, "office": 0.8, "plain-corridor": 0.8}  # of the keyframes tried
USUAL_SPACING_M = 2.0
MEAN_M = 0.3  # the usual constant interval, whose number of matches is the budget


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Keyframes, what SDP-PE sees of their walls, and how far off matches to them are."""

    world: NDArray[np.str_]  # (n,)
    sums: Array  # (n, 4) of Equation 2, m
    square_error: Array  # (n, distances) m^2: mean square shift of the points that are seen

    @property
    def share(self) -> Array:
        """(n,) each world counts the same."""
        counts = {world: np.sum(self.world == world) for world in set(self.world.tolist())}
        return np.array([1.0 / counts[world] for world in self.world.tolist()]) / len(counts)

    def error_after(self, lengths: Array) -> Array:
        """(n,) square error of a match after each length, relative to the world's usual one."""
        logs = np.log(DISTANCES_M)
        at = np.clip((np.log(lengths) - logs[0]) / (logs[1] - logs[0]), 0.0, len(logs) - 1.001)
        low, part, row = at.astype(np.int64), at % 1.0, np.arange(len(at))
        error = self.square_error[row, low] * (1.0 - part)
        error += self.square_error[row, low + 1] * part
        usual = {w: np.mean(self.square_error[self.world == w]) for w in set(self.world.tolist())}
        relative: Array = error / np.array([usual[world] for world in self.world.tolist()])
        return relative


@dataclass(frozen=True, slots=True)
class Weights:
    """What is fitted; w1 and w3 are 1."""

    second: float  # w2 and w4
    t_low: float
    t_high: float

    def lengths(self, samples: Samples) -> Array:
        """(n,) the interval after each keyframe, m."""
        config = KeyframeConfig()
        t_pe = samples.sums @ np.array([1.0, self.second, 1.0, self.second]) / 2.0
        share = np.clip((t_pe - self.t_low) / (self.t_high - self.t_low), 0.0, 1.0)
        lengths: Array = config.min_interval + share * (config.max_interval - config.min_interval)
        return lengths


def bench_weights(quick: bool, echo: Echo) -> dict[str, Any]:
    """Fit on the training worlds; judge there with other seeds, and in other worlds."""
    sets = {}
    for name, (first, seeds) in SEEDS.items():
        worlds = OTHER if name == "other" else TRAINING
        echo(f"{name}: {', '.join(worlds)}")
        numbers = range(first, first + (QUICK_SEEDS if quick else seeds))
        sets[name] = joined([sampled(world, seed) for world in worlds for seed in numbers])
    fitted = fit(sets["training"])
    config = KeyframeConfig()
    shipped = Weights(config.weights[1] / config.weights[0], config.t_low, config.t_high)
    rows = [
        {"weights": which, "samples": name, **judged(weights, samples)}
        for which, weights in (("fitted", fitted), ("shipped", shipped))
        for name, samples in sets.items()
    ]
    _show(fitted, rows)
    meta = {
        "training": TRAINING, "other": OTHER, "seeds": SEEDS, "mean_interval_m": MEAN_M,
        "limits_m": [config.min_interval, config.max_interval],
        "fitted": {"weights": [1.0, fitted.second] * 2, "t_low": fitted.t_low,
                   "t_high": fitted.t_high},
    }  # fmt: skip
    return {"meta": meta, "rows": rows}


def sampled(world: str, seed: int) -> Samples:
    """Matches from keyframes all along one drive; where the robot turns there is no choice."""
    messages = list(simulate(scenario(world, seed), seed=seed))
    extrinsics = next(m for m in messages if isinstance(m, LaserExtrinsics))
    scans = [m for m in messages if isinstance(m, LaserScan)]
    truth = _poses(m for m in messages if isinstance(m, TruePose))
    wheels = _poses(m for m in messages if isinstance(m, WheelOdometry))
    at = [truth[scan.stamp_ns] for scan in scans]
    moved = [wheels[scan.stamp_ns] for scan in scans]
    places = np.array([[pose.x(), pose.y()] for pose in at])
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    sums, errors = [], []
    spacing = SPACING_M.get(world, USUAL_SPACING_M)
    for start in np.arange(0.3, path[-1] - DISTANCES_M[-1] - 0.2, spacing):
        i = int(np.searchsorted(path, start))
        later = [int(np.searchsorted(path, path[i] + d)) for d in DISTANCES_M]
        if any(abs(at[i].between(at[j]).theta()) > KeyframeConfig().max_turn for j in later):
            continue
        key = prepare(scans[i], extrinsics, ScanConfig())
        seconds = [1e-9 * (scans[j].stamp_ns - scans[i].stamp_ns) for j in later]
        errors.append(
            [
                _square_error(key, prepare(scans[j], extrinsics, ScanConfig()),
                              at[i].between(at[j]), moved[i].between(moved[j]), s)
                for j, s in zip(later, seconds, strict=True)
            ]
        )  # fmt: skip
        sums.append(_sums(key))
    return Samples(np.array([world] * len(sums)), np.array(sums), np.array(errors))


def joined(parts: Sequence[Samples]) -> Samples:
    """All samples together."""
    return Samples(
        np.concatenate([part.world for part in parts]),
        np.concatenate([part.sums for part in parts]),
        np.concatenate([part.square_error for part in parts]),
    )


def fit(samples: Samples) -> Weights:
    """The weights whose matches add the least variance a metre; the same each time."""

    def cost(found: Array) -> float:
        return _variance(within_budget(float(10.0 ** found[0]), float(found[1]), samples), samples)

    bounds = Bounds(np.array([-1.3, 0.0]), np.array([1.3, 1.5]))  # log10 of w2, and t_low (m)
    found = differential_evolution(
        cost, bounds, rng=np.random.default_rng(1), maxiter=40, popsize=12, polish=False
    )
    return within_budget(float(10.0 ** found.x[0]), float(found.x[1]), samples)


def within_budget(second: float, t_low: float, samples: Samples) -> Weights:
    """With t_high such that there are as many matches as with a constant interval `MEAN_M`."""
    low, high = t_low + 1e-3, 1e3
    for _ in range(50):
        middle = float(np.sqrt(low * high))
        if mean_interval(Weights(second, t_low, middle).lengths(samples), samples) > MEAN_M:
            low = middle
        else:
            high = middle
    return Weights(second, t_low, high)


def mean_interval(lengths: Array, samples: Samples) -> float:
    """The constant interval with as many matches, m."""
    return float(1.0 / np.sum(samples.share / lengths))


def judged(weights: Weights, samples: Samples) -> dict[str, Any]:
    """Variance a metre over that of a constant interval with as many matches; under 1 is better."""
    lengths = weights.lengths(samples)
    mean = mean_interval(lengths, samples)
    even = np.full(len(lengths), mean)
    constant = float(np.sum(samples.share * samples.error_after(even) / even))
    return {
        "keyframes": len(lengths),
        "mean_interval_m": mean,
        "variance_ratio": _variance(weights, samples) / constant,
        "interval_m": {
            world: float(np.mean(lengths[samples.world == world]))
            for world in sorted(set(samples.world.tolist()))
        },
    }


def _variance(weights: Weights, samples: Samples) -> float:
    lengths = weights.lengths(samples)
    return float(np.sum(samples.share * samples.error_after(lengths) / lengths))


def _square_error(
    key: PreparedScan, later: PreparedScan, true: Pose2, moved: Pose2, seconds: float
) -> float:
    """Mean square shift (m^2) of the key's points by what a match with odometry is off by."""
    length = float(np.hypot(moved.x(), moved.y()))
    prior = Prior(moved, OdometryConfig().covariance(length, abs(moved.theta()), seconds))
    found = match([Reference(Pose2(), key)], later, moved, MatchConfig(), prior)
    off = true.between(found.target_T_source)
    square_reach = float(np.nanmean(np.sum(key.points**2, axis=1)))
    return float(off.x() ** 2 + off.y() ** 2 + square_reach * off.theta() ** 2)


def _sums(key: PreparedScan) -> tuple[float, float, float, float]:
    config = KeyframeConfig()
    left, right = map(
        wall_sums, wall_profiles(key.points, config.profile_reach, config.profile_bin)
    )
    return left.diff, left.diff2, right.diff, right.diff2


def _poses(messages: Iterator[TruePose | WheelOdometry]) -> dict[int, Pose2]:
    return {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in messages}


def _show(fitted: Weights, rows: Sequence[dict[str, Any]]) -> None:
    table = Table(
        title=f"w1 = w3 = 1, w2 = w4 = {fitted.second:.3f}, "
        f"t_low = {fitted.t_low:.3f}, t_high = {fitted.t_high:.3f}"
    )
    for head in ("weights", "samples", "keyframes", "mean m", "variance a metre, constant = 1"):
        table.add_column(head, justify="left" if head in ("weights", "samples") else "right")
    for row in rows:
        table.add_row(
            row["weights"], row["samples"], str(row["keyframes"]),
            f"{row['mean_interval_m']:.2f}", f"{row['variance_ratio']:.2f}",
        )  # fmt: skip
    Console().print(table)
