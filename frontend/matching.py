"""`match`: where was the robot, given what it sees now and what it saw before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from frontend import icp_kernels as kernels
from frontend.scan import PreparedScan

Matrix = NDArray[np.float64]
Method = Literal["point_to_line", "point_to_point", "ndt", "psm"]


class MatchConfig(BaseModel):
    """The scan matcher."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field("point_to_line", description="how scans are aligned")
    range_noise: float = Field(0.010, gt=0, description="m, one sigma of a single reading")
    search_gate: float = Field(2.0, gt=0, description="m, pairing distance when nothing is known")
    final_gate: float = Field(0.15, gt=0, description="m, pairing distance of the last pass")
    final_scale: float = Field(0.04, gt=0, description="m, residual at which a pair weighs 1/4")
    coarse_beams: int = Field(60, ge=10, description="beams used before the last pass")
    iterations: int = Field(25, ge=1, description="at most, per pass")
    tolerance: float = Field(2e-4, gt=0, description="m, a smaller step ends the iteration")
    min_pairs: int = Field(15, ge=3, description="with fewer pairs the match is refused")
    min_explained: float = Field(
        0.35, ge=0, le=1, description="share of paired beams that must fit"
    )
    correlation: float = Field(
        2.0,
        gt=0,
        description="how many times the independent-beam covariance understates the true one",
    )
    floor_trans: float = Field(0.004, ge=0, description="m, bias that no number of beams removes")
    floor_rot: float = Field(0.0015, ge=0, description="rad, the same for the heading")


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """A fixed scan to match against, and where it stands in the target frame."""

    target_T_scan: Pose2
    scan: PreparedScan


@dataclass(frozen=True, eq=False, slots=True)
class Prior:
    """What is known before the match: a pose and the covariance of its error, in its own frame."""

    target_T_source: Pose2
    covariance: Matrix  # (3, 3) of (x, y, theta): m^2, m rad, rad^2


@dataclass(frozen=True, eq=False, slots=True)
class MatchResult:
    """All that a match knows; covariances are of (x, y, theta) in the source frame."""

    target_T_source: Pose2
    information: Matrix  # (3, 3) of the scans alone, the prior left out
    covariance: Matrix  # (3, 3) of the pose, the prior included
    pairs: int
    explained: float  # share of the pairs within `final_scale` of their line
    overlap: float  # share of the beams that found a partner in any reference
    quality: float  # share of the beams that fit a line of any reference
    rms: float  # m, robust, of the residuals
    weak_axis: float | None  # rad, direction in the source frame that the prior carries, if any
    weakness: float  # own sigma over the prior's sigma along that axis (or the weakest one)
    iterations: int
    converged: bool
    reason: str  # why it was refused; empty when it was not

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """One-sigma of x (m), y (m) and theta (rad)."""
        sx, sy, st = np.sqrt(np.diag(self.covariance))
        return float(sx), float(sy), float(st)


# An iteration that still swings by a few tolerances stands well within the bias floor.
SETTLED = 10.0

_NO_INFORMATION = np.zeros((3, 3))
# What stands in for a missing prior: a metre and a radian know nothing, but keep matrices regular.
_IGNORANCE = np.diag([1.0, 1.0, 1.0])


def match(
    references: Sequence[Reference],
    source: PreparedScan,
    guess: Pose2,
    config: MatchConfig,
    prior: Prior | None = None,
) -> MatchResult:
    """Align `source` to all references at once, starting from `guess` (target_T_source).

    A refused match is an outcome: `converged` is False and `reason` says why; the pose is then
    the guess.  With a prior, an axis that the scans do not see keeps what the prior says.
    """
    stack = _stack(references)
    pose = np.array([guess.x(), guess.y(), guess.theta()])
    system = np.zeros(kernels.SYSTEM)
    if source.valid < config.min_pairs:
        return _refused(guess, prior, f"only {source.valid} usable beams")
    if stack is None:
        return _refused(guess, prior, "no reference has usable beams")
    information = _NO_INFORMATION if prior is None else np.linalg.inv(prior.covariance)
    centre = pose.copy() if prior is None else _vector(prior.target_T_source)
    iterations = 0
    size = 0.0
    for gate, scale, tolerance, beams in _passes(config, prior):
        stride = max(1, len(source.points) // beams) if beams else 1
        size, count = kernels.gauss_newton(
            source.points, source.lines, source.flags, stride,
            stack[0], stack[1], stack[2], stack[3], stack[4], stack[5],
            pose, centre, information, config.range_noise, gate, scale,
            config.iterations, tolerance, system,
        )  # fmt: skip
        iterations += count
    return _judge(pose, system, len(references), iterations, size, guess, prior, config)


def _vector(pose: Pose2) -> Matrix:
    return np.array([pose.x(), pose.y(), pose.theta()])


def _passes(config: MatchConfig, prior: Prior | None) -> list[tuple[float, float, float, int]]:
    """Gate (m), robust scale (m), tolerance (m) and beams (0 for all) of each pass."""
    final = (config.final_gate, config.final_scale, config.tolerance, 0)
    middle = (0.6, 0.2, 0.01, config.coarse_beams)
    if prior is None:
        return [
            (config.search_gate, 0.5 * config.search_gate, 0.02, config.coarse_beams),
            middle,
            final,
        ]
    return [middle, final]


def _stack(references: Sequence[Reference]) -> tuple[Any, ...] | None:
    """The references' arrays end to end, as the kernels take them."""
    used = [r for r in references if r.scan.valid > 2]
    if not used:
        return None
    poses = np.array([_vector(r.target_T_scan) for r in used])
    if len(used) == 1:
        scan = used[0].scan
        starts = np.array([0, len(scan.points)])
        return scan.points, scan.lines, scan.flags, starts, scan.geometry[None], poses
    return (
        np.concatenate([r.scan.points for r in used]),
        np.concatenate([r.scan.lines for r in used]),
        np.concatenate([r.scan.flags for r in used]),
        np.cumsum([0] + [len(r.scan.points) for r in used]),
        np.array([r.scan.geometry for r in used]),
        poses,
    )


def _refused(guess: Pose2, prior: Prior | None, reason: str) -> MatchResult:
    covariance = _IGNORANCE if prior is None else prior.covariance
    return MatchResult(
        guess, _NO_INFORMATION, covariance, 0, 0.0, 0.0, 0.0, 0.0, None, np.inf, 0, False, reason
    )


def _judge(
    pose: Matrix, system: Matrix, references: int, iterations: int, last_step: float,
    guess: Pose2, prior: Prior | None, config: MatchConfig,
) -> MatchResult:  # fmt: skip
    pairs = int(system[kernels.PAIRS])
    if pairs < config.min_pairs:
        return _refused(guess, prior, f"only {pairs} pairs")
    explained = float(system[kernels.INLIERS] / pairs)
    information = own_information(system, references, config)
    known = _IGNORANCE if prior is None else prior.covariance
    covariance = np.linalg.inv(information + np.linalg.inv(known))
    axis, weakness = weakest_axis(information, known)
    reason = ""
    if last_step > SETTLED * config.tolerance:
        reason = f"no convergence in {iterations} iterations"
    elif explained < config.min_explained:
        reason = f"only {100 * explained:.0f} % of the beams fit"
    return MatchResult(
        Pose2(pose[0], pose[1], pose[2]), information, covariance, pairs, explained,
        float(system[kernels.PAIRED] / system[kernels.TRIED]),
        float(system[kernels.FITTING] / system[kernels.TRIED]),
        float(np.sqrt(system[kernels.COST] / system[kernels.WEIGHT])),
        axis if weakness > 1.0 else None, weakness, iterations, not reason, reason,
    )  # fmt: skip


def own_information(system: Matrix, references: int, config: MatchConfig) -> Matrix:
    """(3, 3) information of the match alone, with what noisy normals feign taken out.

    Normals that err by a variance s2 turn the information n n' into n n' + s2 t t': a plain
    wall seems to know where along it the robot is.  The expected surplus is subtracted, then
    the bias floor is added to the covariance (in information form, since axes may be blind).
    """
    h = system[:6]
    fisher = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
    f = kernels.FEIGNED
    feigned = np.array([[system[f], system[f + 1]], [system[f + 1], system[f + 2]]])
    # Each reference adds pairs of the same source beams: their noise is not averaged again.
    spread = config.range_noise**2 * config.correlation * max(references, 1)
    fisher[:2, :2] -= _no_more_than(feigned, fisher[:2, :2])
    fisher /= spread
    # (fisher^-1 + floor)^-1 in the floor's units, where eigenvalues compare and stay positive.
    root = np.array([config.floor_trans, config.floor_trans, config.floor_rot])
    values, vectors = np.linalg.eigh(fisher * np.outer(root, root))
    values = np.maximum(values, 0.0)
    scaled = (vectors * (values / (1.0 + values))) @ vectors.T
    information: Matrix = scaled / np.outer(root, root)
    information = 0.5 * (information + information.T)
    return information


def _no_more_than(feigned: Matrix, fisher: Matrix) -> Matrix:
    """`feigned`, limited so that the difference keeps no negative direction."""
    values, vectors = np.linalg.eigh(fisher - feigned)
    if values[0] >= 0.0:
        return feigned
    excess: Matrix = fisher - (vectors * np.maximum(values, 0.0)) @ vectors.T
    return excess


def weakest_axis(information: Matrix, known: Matrix) -> tuple[float, float]:
    """Direction (rad) of the translation that the match knows worst, and by what ratio.

    The ratio is the match's own sigma over the sigma that `known` (3, 3) promises along the
    same axis: above one, the axis belongs to the odometry.  Heading is marginalised.
    """
    turn = information[2, 2]
    shift = information[:2, :2].copy()
    if turn > 0:
        shift -= np.outer(information[:2, 2], information[2, :2]) / turn
    values, vectors = np.linalg.eigh(shift)
    axis = vectors[:, 0]
    promised = float(axis @ known[:2, :2] @ axis)
    weakness = float(np.sqrt(1.0 / (max(values[0], 1e-12) * promised)))
    return float(np.arctan2(axis[1], axis[0])), weakness
