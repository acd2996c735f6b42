"""The batch's own algebra against GTSAM's, to the bit."""

import numpy as np
from gtsam import Pose2
from slam.frontend.batch_kernels import between, views


def test_poses_are_composed_as_gtsam_does_it():
    rng = np.random.default_rng(0)
    for a, b in rng.normal(0.0, 30.0, (2000, 2, 3)):
        expected = Pose2(*a).between(Pose2(*b))
        assert between(a, b) == (expected.x(), expected.y(), expected.theta())


def test_points_are_moved_as_gtsam_does_it():
    rng = np.random.default_rng(1)
    poses, centres, out = (
        rng.normal(0, 30, (500, 3)),
        rng.normal(0, 9, (500, 2)),
        np.empty((500, 4)),
    )
    views(poses, centres, out)
    for pose, centre, found in zip(poses, centres, out, strict=True):
        assert found.tolist() == [*Pose2(*pose).transformFrom(centre), pose[0], pose[1]]
