"""What `a_T_b`, tangents and covariances mean, held against GTSAM itself."""

import gtsam
import numpy as np
from gtsam import Pose2
from gtsam.symbol_shorthand import X
from hypothesis import given
from hypothesis import strategies as st
from slam.backend.edges import Edge, relative_covariance

far = st.builds(Pose2, *[st.floats(-50, 50)] * 2, st.floats(-3.1, 3.1))
near = st.builds(Pose2, *[st.floats(-1e-7, 1e-7)] * 3)  # where small-angle formulas take over
poses = far | near
tangents = st.tuples(*[st.floats(-1e-3, 1e-3)] * 3).map(np.array)


@given(poses, poses, poses)
def test_inner_names_cancel(a_T_b, b_T_c, c_T_d):
    a_T_d = a_T_b * b_T_c * c_T_d
    assert a_T_d.equals(a_T_b * (b_T_c * c_T_d), 1e-8)
    assert a_T_b.between(a_T_b * b_T_c).equals(b_T_c, 1e-8)
    assert (a_T_b * a_T_b.inverse()).equals(Pose2(), 1e-8)


@given(poses, poses, st.floats(-10, 10), st.floats(-10, 10))
def test_a_pose_named_a_b_takes_points_of_b_into_a(a_T_b, b_T_c, x, y):
    point_c = np.array([x, y])
    there = a_T_b.transformFrom(b_T_c.transformFrom(point_c))
    np.testing.assert_allclose((a_T_b * b_T_c).transformFrom(point_c), there, atol=1e-8)
    c, s = np.cos(a_T_b.theta()), np.sin(a_T_b.theta())
    by_hand = [a_T_b.x() + c * x - s * y, a_T_b.y() + s * x + c * y]
    np.testing.assert_allclose(a_T_b.transformFrom(point_c), by_hand, atol=1e-8)


@given(poses, tangents)
def test_a_tangent_is_x_y_theta_in_the_frame_of_the_pose(a_T_b, tangent):
    moved = a_T_b * Pose2.Expmap(tangent)
    b_T_moved = a_T_b.between(moved)
    # To first order; the second is a millionth of a tangent of a thousandth.
    np.testing.assert_allclose(
        [b_T_moved.x(), b_T_moved.y(), b_T_moved.theta()], tangent, atol=2e-6
    )
    np.testing.assert_allclose(Pose2.Logmap(b_T_moved), tangent, atol=1e-7)


@given(poses, poses, tangents)
def test_the_residual_of_an_edge_lives_in_its_second_frame(map_T_i, i_T_j, noise):
    edge = Edge("icp", 0, 1, i_T_j * Pose2.Expmap(noise), np.eye(3))
    map_T_j = map_T_i * i_T_j
    stacked = np.array([[p.x(), p.y(), p.theta()] for p in (map_T_i, map_T_j)])
    np.testing.assert_allclose(edge.residual(stacked), -noise, atol=1e-7)
    assert abs(edge.chi_square(stacked) - noise @ noise) < 1e-8


@given(poses, poses, tangents)
def test_an_edge_and_gtsam_agree_about_its_error(map_T_i, map_T_j, noise):
    i_T_j = map_T_i.between(map_T_j) * Pose2.Expmap(noise)
    information = np.array([[40.0, 3.0, 1.0], [3.0, 90.0, -2.0], [1.0, -2.0, 400.0]])
    edge = Edge("icp", 0, 1, i_T_j, information)
    model = gtsam.noiseModel.Gaussian.Information(information)
    values = gtsam.Values()
    values.insert(X(0), map_T_i)
    values.insert(X(1), map_T_j)
    factor = gtsam.BetweenFactorPose2(X(0), X(1), i_T_j, model)
    stacked = np.array([[p.x(), p.y(), p.theta()] for p in (map_T_i, map_T_j)])
    assert abs(edge.chi_square(stacked) - 2.0 * factor.error(values)) < 1e-6


@given(far, far)
def test_covariance_of_a_relative_pose_follows_its_derivatives(map_T_i, map_T_j):
    """Against finite differences of i_T_j by disturbances of both poses in their own frames."""
    i_T_j = map_T_i.between(map_T_j)
    jacobian, h = np.zeros((3, 6)), 1e-5
    for k in range(6):
        ends = []
        for sign in (h, -h):
            shift = np.zeros(6)
            shift[k] = sign
            i, j = map_T_i * Pose2.Expmap(shift[:3]), map_T_j * Pose2.Expmap(shift[3:])
            ends.append(Pose2.Logmap(i_T_j.between(i.between(j))))
        jacobian[:, k] = (ends[0] - ends[1]) / (2 * h)
    root = np.random.default_rng(0).standard_normal((6, 6))
    joint = root @ root.T
    expected = jacobian @ joint @ jacobian.T
    found = relative_covariance(joint, i_T_j)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-4 * np.abs(expected).max())
