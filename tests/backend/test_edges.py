"""What may not enter the graph: GTSAM would return nonsense or abort."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.edges import Edge, GraphError


def with_entry(row, column, value):
    matrix = np.diag([100.0, 100.0, 400.0])
    matrix[row, column] = value
    return matrix


@pytest.mark.parametrize(
    ("pose", "information", "message"),
    [
        (Pose2(np.nan, 0, 0), np.eye(3), "not finite"),
        (Pose2(0, np.inf, 0), np.eye(3), "not finite"),
        (Pose2(0, 0, np.nan), np.eye(3), "not finite"),
        (Pose2(), with_entry(0, 0, np.nan), "not finite"),
        (Pose2(), with_entry(1, 1, np.inf), "not finite"),
        (Pose2(), with_entry(0, 1, 5.0), "not symmetric"),
        (Pose2(), with_entry(2, 2, -1.0), "negative eigenvalue"),
        (Pose2(), np.full((3, 3), 2.0) - np.eye(3), "negative eigenvalue"),
        (Pose2(), np.eye(2), "3 by 3"),
        (Pose2(), np.eye(6), "3 by 3"),
    ],
)
def test_a_bad_measurement_is_refused_by_name(pose, information, message):
    with pytest.raises(GraphError, match=rf"loop edge 3-7.*{message}"):
        Edge("loop", 3, 7, pose, information)


@pytest.mark.parametrize(
    "information",
    [
        np.zeros((3, 3)),  # says nothing
        np.diag([0.0, 100.0, 400.0]),  # blind along a corridor
        np.diag([1e-12, 1e12, 1.0]),
        with_entry(0, 1, 1e-12),  # rounding is not asymmetry
    ],
)
def test_a_measurement_may_be_blind(information):
    assert Edge("icp", 0, 1, Pose2(), information).information is information
