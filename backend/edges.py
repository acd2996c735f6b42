"""What the graph is made of: edges between poses, checked before GTSAM sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.backend.se2 import logmap, unwrapped_between

Matrix = NDArray[np.float64]
Kind = Literal["odometry", "icp", "loop"]


NEAR_SINGULAR = 1e5  # ratio of an information's eigenvalues beyond which it is capped
BEST_INFORMATION = 1e6  # 1 / m^2 or 1 / rad^2: a sigma of a millimetre or a milliradian


class GraphError(ValueError):
    """A measurement cannot enter the graph; the message says which and why."""

    explains_itself = True  # the command line shows it as one line


@dataclass(frozen=True, eq=False, slots=True)
class Edge:
    """One relative-pose measurement; `information` is of (x, y, theta) in frame j."""

    kind: Kind
    i: int
    j: int
    i_T_j: Pose2
    information: Matrix  # (3, 3), symmetric, at least semi-definite

    def __post_init__(self) -> None:
        """Refuse what would make GTSAM return nonsense or abort the interpreter.

        Raises:
            GraphError: not finite, not symmetric, or with a negative eigenvalue.
        """
        name = f"{self.kind} edge {self.i}-{self.j}"
        numbers = (self.i_T_j.x(), self.i_T_j.y(), self.i_T_j.theta())
        if not (np.isfinite(numbers).all() and np.isfinite(self.information).all()):
            raise GraphError(f"{name}: pose or information is not finite")
        if self.information.shape != (3, 3):
            raise GraphError(f"{name}: information must be 3 by 3, got {self.information.shape}")
        scale = max(float(np.abs(self.information).max()), 1e-300)
        if np.abs(self.information - self.information.T).max() > 1e-9 * scale:
            raise GraphError(f"{name}: information is not symmetric")
        if np.linalg.eigvalsh(self.information)[0] < -1e-9 * scale:
            raise GraphError(f"{name}: information has a negative eigenvalue")

    def renamed(self, i: int, j: int) -> Edge:
        """The same measurement under other indices; it was checked before."""
        other = object.__new__(Edge)
        for name, value in zip(
            self.__slots__, (self.kind, i, j, self.i_T_j, self.information), strict=True
        ):
            object.__setattr__(other, name, value)
        return other

    def residual(self, poses: Matrix) -> Matrix:
        """(3,) error of the measurement at poses (n, 3) of [x, y, theta]."""
        at_i, at_j = Pose2(*poses[self.i]), Pose2(*poses[self.j])
        error: Matrix = Pose2.Logmap(self.i_T_j.between(at_i.between(at_j)))
        return error

    def chi_square(self, poses: Matrix) -> float:
        """Squared Mahalanobis norm of the residual, 3 degrees of freedom."""
        error = self.residual(poses)
        return float(error @ self.information @ error)


def residuals(poses: Matrix, edges: Sequence[Edge]) -> Matrix:
    """(edges, 3) what `Edge.residual` gives for each, all at once."""
    i, j = (np.array([getattr(edge, end) for edge in edges], dtype=np.int64) for end in "ij")
    measured = np.array([(e.i_T_j.x(), e.i_T_j.y(), e.i_T_j.theta()) for e in edges])
    measured = measured.reshape(-1, 3)
    # Headings are wrapped once, by the logarithm.
    return logmap(unwrapped_between(measured, unwrapped_between(poses[i], poses[j])))


def relative_covariance(joint: Matrix, i_T_j: Pose2) -> Matrix:
    """(3, 3) covariance of i_T_j in frame j from the joint (6, 6) of poses i, j in their own."""
    jacobian = np.hstack([-i_T_j.inverse().AdjointMap(), np.eye(3)])
    covariance: Matrix = jacobian @ joint @ jacobian.T
    return covariance


def capped(edge: Edge) -> Edge:
    """The edge itself, or with its best-known axes capped if its information is near-singular.

    Some public graphs claim micrometres along one axis and decimetres along another; such
    blocks stop Levenberg-Marquardt at its first step.  No scan match is better than a millimetre.
    """
    values, vectors = np.linalg.eigh(edge.information)
    if values[-1] <= NEAR_SINGULAR * max(values[0], 0.0):
        return edge
    information = (vectors * np.clip(values, 0.0, BEST_INFORMATION)) @ vectors.T
    return Edge(edge.kind, edge.i, edge.j, edge.i_T_j, 0.5 * (information + information.T))
