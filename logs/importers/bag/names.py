"""Names of frames and topics: prefixes, last parts, and what they tell."""

from __future__ import annotations

WORLD_FRAMES = ("map", "world", "earth", "utm", "gps", "global", "ground_truth", "mocap", "vicon")
"""Last parts of frames that stand for the building: what leads from them is no odometry."""


def plain(frame: str) -> str:
    """Return a frame's name without the leading slash that ROS 1 programs wrote."""
    return frame.strip().strip("/")


def leaf(frame: str) -> str:
    """Return the last part of a frame's or topic's name."""
    return frame.rpartition("/")[2]


def prefix(frame: str) -> str:
    """Return what stands before the last part: the robot, where there are several."""
    return plain(frame).rpartition("/")[0]


def is_odom(frame: str) -> bool:
    """Whether a frame is one that odometry counts in, by its name."""
    return "odom" in leaf(frame).lower()


def is_world(frame: str) -> bool:
    """Whether a frame stands for the building, by its name."""
    name = leaf(frame).lower()
    return name in WORLD_FRAMES or name.endswith(("_map", "_world"))
