"""Transforms of a recording: which frames sit fast on each other, and how the others move."""

from __future__ import annotations

import math
from array import array
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from slam.logs.importers.bag.names import is_odom, is_world, plain
from slam.logs.importers.bag.transforms import Matrix, matrix_of, stamp_of

TILT_RAD = math.radians(10.0)
"""A laser tilted by more than this does not scan a plane along the floor."""

FAST_M, FAST_RAD = 5e-3, math.radians(0.5)
"""A link that varies by no more than this sits fast: springs and rounding, nothing driven."""

SAME_M, SAME_RAD = 1e-4, 1e-4
"""Two statements of one place that differ by more contradict each other."""

_LINKS_LIMIT = 1000  # a bag is somebody else's
_SAMPLES_LIMIT = 4_000_000  # of all links together, 40 bytes each
_VALUES_KEPT = 4  # different values of a link; more mean that it moves


@dataclass(slots=True)
class Link:
    """`parent_T_child` as it was sent over time."""

    parent: str
    child: str
    static: bool
    last: Matrix
    values: list[Matrix] = field(default_factory=list)  # the first few different ones
    raw: tuple[float, ...] = ()  # the numbers of the last statement
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x, y, theta of it
    count: int = 0
    spread_m: float = 0.0  # against the first value, in the plane
    spread_rad: float = 0.0
    stamps: array[int] = field(default_factory=lambda: array("q"))  # ns; empty where static
    receipts: array[int] = field(default_factory=lambda: array("q"))
    poses: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta of each

    @property
    def fast(self) -> bool:
        """Whether it stays as it is, as far as a planar map can tell."""
        if self.static:
            return True
        fast = self.spread_m <= FAST_M and self.spread_rad <= FAST_RAD
        return fast and not (is_odom(self.parent) or is_world(self.parent))

    @property
    def contradicts_itself(self) -> bool:
        """Whether different places were stated for it, by different programs."""
        return len(self.values) > 1 and (
            self.static or (not self.fast and len(self.values) < _VALUES_KEPT)
        )

    def add(self, matrix: Matrix, stamp_ns: int, receipt_ns: int, keep: bool) -> None:
        """Take in one statement."""
        self.count += 1
        if len(self.values) < _VALUES_KEPT and not any(_same(matrix, v) for v in self.values):
            self.values.append(matrix)
        self.last = matrix
        x, y, yaw = matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0])
        self.pose = (float(x), float(y), yaw)
        first = self.values[0]
        turned = math.remainder(yaw - math.atan2(first[1, 0], first[0, 0]), math.tau)
        self.spread_m = max(self.spread_m, math.hypot(x - first[0, 3], y - first[1, 3]))
        self.spread_rad = max(self.spread_rad, abs(turned))
        if keep and not self.static:
            self.keep(stamp_ns, receipt_ns)

    def keep(self, stamp_ns: int, receipt_ns: int) -> None:
        """Note that the pose last stated was sent at this time."""
        self.stamps.append(stamp_ns)
        self.receipts.append(receipt_ns)
        self.poses.extend(self.pose)


class FrameTree:
    """All links.  Of a child that was given several parents for good, the last one counts."""

    def __init__(self) -> None:
        self.links: dict[tuple[str, str], Link] = {}
        self.refused = 0  # transforms that are not finite, or no rotation
        self._parent: dict[str, str] = {}  # of frames on /tf_static, as last stated
        self._samples = 0

    def add(self, transform: Any, static: bool, receipt_ns: int) -> None:
        """Take in a geometry_msgs/TransformStamped."""
        parent, child = plain(transform.header.frame_id), plain(transform.child_frame_id)
        link = self.links.get((parent, child))
        raw = _numbers(transform.transform)
        if link is not None and not link.static and raw == link.raw:
            self._samples += 1  # most are sent again and again as they are
            link.count += 1
            if self._keeps(link):
                link.keep(stamp_of(transform.header.stamp), receipt_ns)
            return
        matrix = matrix_of(transform.transform.translation, transform.transform.rotation)
        if matrix is None or parent == child:
            self.refused += 1
            return
        if link is None:
            if len(self.links) >= _LINKS_LIMIT:
                return
            link = self.links[parent, child] = Link(parent, child, static, matrix)
        if static:
            self._parent[child] = parent
        if static != link.static:
            # tf2 keeps a frame as it was first sent; what a link is sent as later is the same.
            static = link.static
        self._samples += not static
        link.raw = raw
        link.add(matrix, stamp_of(transform.header.stamp), receipt_ns, self._keeps(link))

    def _keeps(self, link: Link) -> bool:
        return self._samples <= _SAMPLES_LIMIT or is_odom(link.parent)

    @property
    def frames(self) -> list[str]:
        """All frames, in order of the alphabet."""
        return sorted(
            {frame for link in self.links.values() for frame in (link.parent, link.child)}
        )

    def fast_links(self) -> list[Link]:
        """The links that hold for good: of static ones, those to the parent last stated."""
        return [
            link
            for link in self.links.values()
            if link.fast and not (link.static and self._parent.get(link.child) != link.parent)
        ]

    def rivals(self, link: Link) -> list[Link]:
        """Other links that say for good where this link's child sits."""
        return [
            other
            for other in self.links.values()
            if other.child == link.child and other is not link and other.static and link.static
        ]

    def path(self, start: str, goal: str) -> list[Link] | None:
        """Return the fast links from one frame to another, None if they are not connected."""
        links = self.fast_links()
        came: dict[str, Link | None] = {start: None}
        queue = deque([start])
        while queue:
            frame = queue.popleft()
            for link in links:
                for here, there in ((link.parent, link.child), (link.child, link.parent)):
                    if here == frame and there not in came:
                        came[there] = link
                        queue.append(there)
        if goal not in came:
            return None
        path: list[Link] = []
        frame = goal
        while (step := came[frame]) is not None:
            path.append(step)
            frame = step.parent if step.child == frame else step.child
        return path[::-1]

    def fast_with(self, frame: str) -> set[str]:
        """Return the frames that sit fast on one, itself included."""
        found, queue = {frame}, deque([frame])
        links = self.fast_links()
        while queue:
            here = queue.popleft()
            for link in links:
                for a, b in ((link.parent, link.child), (link.child, link.parent)):
                    if a == here and b not in found:
                        found.add(b)
                        queue.append(b)
        return found


def along(path: list[Link], start: str) -> Matrix:
    """Return start_T_end over a path."""
    matrix: Matrix = np.eye(4)
    for link in path:
        forward = link.parent == start
        matrix = matrix @ (link.last if forward else np.linalg.inv(link.last))
        start = link.child if forward else link.parent
    return matrix


def _numbers(transform: Any) -> tuple[float, ...]:
    t, q = transform.translation, transform.rotation
    return t.x, t.y, t.z, q.x, q.y, q.z, q.w


def _same(a: Matrix, b: Matrix) -> bool:
    return bool(
        np.abs(a[:3, 3] - b[:3, 3]).max() <= SAME_M
        and np.abs(a[:3, :3] - b[:3, :3]).max() <= SAME_RAD
    )
