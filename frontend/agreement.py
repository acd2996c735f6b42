"""How much of a scan agrees with other scans at a pose, counted in independent pieces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from gtsam import Pose2
from slam.frontend.agreement_kernels import count_pieces
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import stack_references
from slam.frontend.scan import PreparedScan

# ln(0.93 / 0.07): at the right pose about one piece in fourteen does not fit, for people walk and
# edges are seen from elsewhere.  By this much a piece that contradicts makes a pose less likely.
CONTRADICTION_NATS = 2.6
# A piece where nobody has looked before speaks against a pose at which it would be known, but
# weakly: a robot that moves sees new walls.
NEW_NATS = 1.0


class Agreement(NamedTuple):
    """Pieces of a scan by what other scans say of them; together all pieces."""

    fitting: float
    new: float
    contradicting: float

    @property
    def share(self) -> float:
        """Share of the pieces that fit, of those that could; 0 if there are none."""
        known = self.fitting + self.contradicting
        return self.fitting / known if known else 0.0

    @property
    def log_likelihood(self) -> float:
        """Nats, against a scan that fits entirely."""
        return -CONTRADICTION_NATS * self.contradicting - NEW_NATS * self.new


def agreement(
    references: Sequence[Reference], scan: PreparedScan, target_T_scan: Pose2, config: MatchConfig
) -> Agreement:
    """Judge a pose by what the references have seen, lines and points alike."""
    stacked = stack_references(references)
    if stacked is None:
        return Agreement(0.0, 0.0, 0.0)
    source = scan.points, scan.lines, scan.flags, scan.geometry
    pose = target_T_scan.x(), target_T_scan.y(), target_T_scan.theta()
    return Agreement(*count_pieces(source, stacked, pose, config.final_gate, config.final_scale))
