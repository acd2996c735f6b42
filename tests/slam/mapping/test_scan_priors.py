"""What is known of a scan from the keyframes around it."""

import numpy as np

from slam.mapping.scan_priors import predict_poses

# A metre a scan by the wheels; scans 0, 2 and 5 are keyframes.
ODOMETRY = np.array([[float(k), 0.0, 0.0] for k in range(7)])
SCANS = np.array([0, 2, 5])
PLACES = np.array([[0.0, 0.0, 0.0], [2.4, 0.0, 0.0], [5.4, 0.0, 0.0]])


def test_a_scan_is_expected_between_its_keyframes():
    predicted = predict_poses(ODOMETRY, SCANS, PLACES, ())
    np.testing.assert_allclose(
        predicted.poses[:, 0], [0.0, 1.2, 2.4, 3.4, 4.4, 5.4, 6.4], atol=1e-9
    )
    assert predicted.before.tolist() == [0, 0, 1, 1, 1, 2, 2]


def test_it_reaches_as_far_as_the_farther_keyframe():
    reach = predict_poses(ODOMETRY, SCANS, PLACES, ()).reach_m
    np.testing.assert_allclose(reach, [0.0, 1.2, 0.0, 2.0, 2.0, 0.0, 1.0], atol=1e-9)


def test_odometry_is_doubted_up_to_the_keyframe_that_refutes_it():
    predicted = predict_poses(ODOMETRY, SCANS, PLACES, {2})
    assert predicted.odometry_faulty.tolist() == [False, True, True, False, False, False, False]
    assert not predict_poses(ODOMETRY, SCANS, PLACES, ()).odometry_faulty.any()


def test_scans_before_the_first_keyframe_hang_on_it():
    predicted = predict_poses(ODOMETRY, SCANS[1:], PLACES[1:], ())
    np.testing.assert_allclose(predicted.poses[:3, 0], [0.4, 1.4, 2.4], atol=1e-9)
    assert predicted.before.tolist() == [0, 0, 0, 0, 0, 1, 1]
    np.testing.assert_allclose(predicted.reach_m[0], 2.0, atol=1e-9)
