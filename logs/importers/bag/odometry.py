"""Odometry out of an inventory, from a topic or from a link of /tf."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from slam.logs.errors import shown
from slam.logs.importers.bag.frames import Link
from slam.logs.importers.bag.inventory import FARTHEST_M, Stream


class Odometry(NamedTuple):
    """Poses of a base in its odometry frame, from a topic or from transforms."""

    name: str  # for people
    parent: str  # frame, empty if not stated
    child: str
    stamps: NDArray[np.int64]  # (n,) ns
    receipts: NDArray[np.int64]
    poses: NDArray[np.float64]  # (n, 3) x (m), y (m), theta (rad)
    flaws: dict[int, str]  # rows that cannot be used, and why
    topic: str = ""  # empty where it comes from transforms


def from_stream(stream: Stream) -> Odometry:
    """Return the odometry of a topic."""
    poses = np.array(stream.poses, dtype=np.float64).reshape(-1, 3)
    return Odometry(
        shown(stream.topic), stream.frame, stream.child, *stream.arrays(), poses,
        dict(stream.flaws), stream.topic,
    )  # fmt: skip


def from_link(link: Link) -> Odometry:
    """Return the odometry that a link of /tf amounts to."""
    stamps, receipts = np.array(link.stamps, np.int64), np.array(link.receipts, np.int64)
    poses = np.array(link.poses, dtype=np.float64).reshape(-1, 3)
    # Some programs send a transform anew until there is another: with the stamp it had.
    fresh = np.concatenate([[True], np.diff(stamps) != 0]) if len(stamps) else stamps == 0
    stamps, receipts, poses = stamps[fresh], receipts[fresh], poses[fresh]
    far = np.flatnonzero(np.abs(poses[:, :2]).max(axis=1) > FARTHEST_M)
    flaws = {int(k): "odometry where no robot can have driven" for k in far}
    name = f"/tf {shown(link.parent)} -> {shown(link.child)}"
    return Odometry(name, link.parent, link.child, stamps, receipts, poses, flaws)
