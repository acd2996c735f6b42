"""The back end: the pose graph on GTSAM."""
