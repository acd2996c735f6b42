"""Back end: the pose graph on GTSAM."""
