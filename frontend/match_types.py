"""What the matcher is given and what it returns: settings, references, priors, results."""

from __future__ import annotations

from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from slam.frontend.scan import PreparedScan

Matrix = NDArray[np.float64]
Triple = tuple[float, float, float]  # x (m), y (m), theta (rad)
Method = Literal["point_to_line", "point_to_point", "ndt", "psm"]

# The coarse pass, which brings a guess within reach of the last one.
# Its gate: three times an odometry error of 0.2 m; walls farther apart do not pair.
COARSE_GATE_M = 0.6
# Its robust scale: the error of the guess must still count in full.
COARSE_SCALE_M = 0.2
# Its tolerance: half the scale of the last pass, which begins where this one ends.
COARSE_TOLERANCE_M = 0.02
COARSE_BEAMS = 60  # of the source: three degrees apart at a view of 180
TOLERANCE_M = 2e-4  # a smaller step ends the last pass; less than the floor of the covariance
# The first pass without a prior: a pair at half the gate weighs 1/4, and a step below this is left
# to the coarse pass.
WIDE_SCALE_SHARE = 0.5  # of `search_gate`
WIDE_TOLERANCE_M = 0.05


class MatchConfig(BaseModel):
    """The scan matcher."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field("point_to_line", description="how scans are aligned")
    # A setting of the laser, handed on by the configuration of the run.
    range_noise: float = Field(0.010, gt=0, exclude=True, description="m, one sigma")
    search_gate: float = Field(2.0, gt=0, description="m, pairing distance when nothing is known")
    final_gate: float = Field(0.15, gt=0, description="m, pairing distance of the last pass")
    final_scale: float = Field(0.04, gt=0, description="m, residual at which a pair weighs 1/4")
    iterations: int = Field(25, ge=1, description="at most, per pass")
    min_pairs: int = Field(15, ge=3, description="with fewer pairs the match is refused")
    good_inlier_fraction: float = Field(
        0.6, ge=0, le=1, description="share of beams that fit, below which other starts are tried"
    )
    min_pair_inlier_fraction: float = Field(
        0.35, ge=0, le=1, description="share of paired beams that must fit"
    )
    correlation: float = Field(
        1.07, gt=0, description="factor on the covariance that range noise alone explains"
    )
    floor_trans: float = Field(0.0003, ge=0, description="m, bias that no number of beams removes")
    floor_rot: float = Field(0.00025, ge=0, description="rad, bias of the heading that stays")

    @cached_property
    def passes_with_prior(self) -> Matrix:
        """(2, 4): gate (m), robust scale (m), tolerance (m) and beams (0 for all) of each pass."""
        return np.array(
            [
                [COARSE_GATE_M, COARSE_SCALE_M, COARSE_TOLERANCE_M, COARSE_BEAMS],
                [self.final_gate, self.final_scale, TOLERANCE_M, 0],
            ]
        )

    @cached_property
    def passes_without_prior(self) -> Matrix:
        """(3, 4): the same with a first pass that reaches farther."""
        scale = WIDE_SCALE_SHARE * self.search_gate
        wide = [self.search_gate, scale, WIDE_TOLERANCE_M, COARSE_BEAMS]
        return np.vstack([[wide], self.passes_with_prior])

    @cached_property
    def limits(self) -> tuple[float, float, float, float, int, int, float]:
        """The fields of `match_arrays.Limits`, as the plain tuple that `align` takes."""
        return (
            self.range_noise, self.range_noise**2 * self.correlation, self.floor_trans,
            self.floor_rot, self.iterations, self.min_pairs, self.good_inlier_fraction,
        )  # fmt: skip


class Reference(NamedTuple):
    """A fixed scan to match against, and where it stands in the target frame."""

    target_T_scan: Pose2
    scan: PreparedScan


class Prior(NamedTuple):
    """What is known before the match: a pose and the covariance of its error, in its own frame."""

    target_T_source: Pose2
    covariance: Matrix  # (3, 3) of (x, y, theta): m^2, m rad, rad^2


class MatchResult(NamedTuple):
    """The outcome of a match; covariances are of (x, y, theta) in the source frame.

    A tuple is made in a quarter of the time that a frozen dataclass takes.
    """

    target_T_source: Pose2
    information: Matrix  # (3, 3) of the scans alone, the prior left out
    covariance: Matrix  # (3, 3) of the pose, the prior included
    pairs: int
    pair_inlier_fraction: float  # share of the pairs within `final_scale` of their line
    overlap: float  # share of the beams with a correspondence in any reference
    inlier_fraction: float  # share of the beams that fit a line of any reference
    rms: float  # m, robust, of the residuals
    # rad in the source frame, the direction that the prior knows better, if there is one
    degenerate_direction: float | None
    condition_ratio: float  # own sigma over the prior's along the weak direction (`degeneracy`)
    iterations: int
    converged: bool
    reason: str  # why it was refused; empty when it was not

    @property
    def sigmas(self) -> tuple[float, float, float]:
        """One-sigma of x (m), y (m) and theta (rad)."""
        sx, sy, st = np.sqrt(np.diag(self.covariance))
        return float(sx), float(sy), float(st)
