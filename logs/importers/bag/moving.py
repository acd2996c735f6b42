"""Mounts over links that move: steady all the same, or refused with what moves."""

from __future__ import annotations

import math

import numpy as np
from slam.logs.errors import shown
from slam.logs.importers.bag.frames import FAST_RAD, FrameTree, Link
from slam.logs.importers.bag.topics import Said
from slam.logs.importers.bag.transforms import Matrix, Mount, planar
from slam.logs.importers.wishes import mount_in_words

HINT = "say --mount x,y,theta (m, m, rad)"
_Pose = tuple[float, float, float]
_SAME_TIME_NS = 1_000_000  # two links stamped no farther apart speak of one moment
_STEADY_M = 0.01  # a mount over moving links may vary by this, which rounding does


def moves(link: Link, base: str, laser: str) -> str:
    """Say in words why a mount over a link cannot be used."""
    if link.contradicts_itself:
        values = " and ".join(mount_in_words(*planar(v)[:3]) for v in link.values)
        return (
            f"the transform {shown(link.parent)} -> {shown(link.child)} is sent as {values} by "
            f"turns: {HINT}"
        )
    return (
        f"the laser moves on the robot: {shown(link.parent)} -> {shown(link.child)} between "
        f"{shown(base)} and {shown(laser)} changes by up to {link.spread_m:.2g} m and "
        f"{math.degrees(link.spread_rad):.0f} deg; a fixed laser is needed, or {HINT}"
    )


def _upwards(tree: FrameTree, frame: str) -> list[Link]:
    """Return the links from a frame to the top, moving ones too; the most frequent parent."""
    path: list[Link] = []
    seen = {frame}
    while True:
        above = [link for link in tree.links.values() if link.child == frame]
        if not above:
            return path
        link = max(above, key=lambda n: (n.fast, n.count))
        if link.parent in seen:
            return path
        seen.add(link.parent)
        path.append(link)
        frame = link.parent


def _meeting(tree: FrameTree, base: str, laser: str) -> tuple[list[Link], list[Link]] | None:
    """Return the links from base and laser up to the first frame above both."""
    up_base, up_laser = _upwards(tree, base), _upwards(tree, laser)
    above_base = [base, *(link.parent for link in up_base)]
    above_laser = [laser, *(link.parent for link in up_laser)]
    for k, frame in enumerate(above_base):
        if frame in above_laser:
            return up_base[:k], up_laser[: above_laser.index(frame)]
    return None


def meets(tree: FrameTree, base: str, laser: str) -> bool:
    """Whether two frames hang under a common one, over whatever links."""
    return _meeting(tree, base, laser) is not None


def moving_between(tree: FrameTree, base: str, laser: str) -> Link | None:
    """Return the first link between two frames, from the second one up, that moves."""
    meeting = _meeting(tree, base, laser)
    links = [*meeting[0], *meeting[1]] if meeting else []
    return next((link for link in reversed(links) if not link.fast), None)


def over_moving_links(tree: FrameTree, base: str, laser: str, said: Said) -> Mount | None:
    """Return the mount where base and laser both hang under one moving frame, and it is steady.

    Some robots send odom -> base_footprint and odom -> base_link side by side.
    """
    meeting = _meeting(tree, base, laser)
    if meeting is None:
        return None
    moving = [[link for link in side if not link.fast] for side in meeting]
    if [len(side) for side in moving] != [1, 1]:
        return None
    pairs = _same_moments(moving[0][0], moving[1][0])
    if not pairs:
        return None
    found = np.array([_mount_then(meeting, (moving[0][0], moving[1][0]), pair) for pair in pairs])
    turned = np.abs(np.remainder(found[:, 2] - found[0, 2] + math.pi, math.tau) - math.pi)
    steady = np.hypot(*(found[:, :2] - found[0, :2]).T).max() <= _STEADY_M
    if not steady or turned.max() > 2 * FAST_RAD:
        return None
    middle = found[len(found) // 2, :3]
    said.notes.append(
        f"laser at {mount_in_words(*middle)} on {shown(base)}, from /tf over "
        f"{shown(moving[0][0].parent)} at equal stamps"
    )
    return Mount(float(middle[0]), float(middle[1]), float(middle[2]))


def _mount_then(
    meeting: tuple[list[Link], list[Link]], moving: tuple[Link, Link], poses: tuple[_Pose, _Pose]
) -> Mount:
    """Return the mount at one moment, with the poses of the two moving links then."""
    top_T_base = _climb(meeting[0], moving[0], poses[0])
    top_T_laser = _climb(meeting[1], moving[1], poses[1])
    return planar(np.linalg.inv(top_T_base) @ top_T_laser)


def _climb(links: list[Link], moving: Link, pose: tuple[float, float, float]) -> Matrix:
    """Return top_T_bottom of links that lead upwards, one of them with the pose of a moment."""
    matrix = np.eye(4)
    for link in links:
        step = link.last
        if link is moving:
            step = np.eye(4)
            c, s = math.cos(pose[2]), math.sin(pose[2])
            step[:2, :2], step[:2, 3] = [[c, -s], [s, c]], pose[:2]
        matrix = step @ matrix
    return matrix


def _same_moments(a: Link, b: Link) -> list[tuple[_Pose, _Pose]]:
    """Return the poses of two links where they bear the same stamp, some hundred at most."""
    if not a.poses or not b.poses:
        return []
    rows_a, rows_b = np.reshape(a.poses, (-1, 3)), np.reshape(b.poses, (-1, 3))
    stamps_a, stamps_b = np.array(a.stamps)[: len(rows_a)], np.array(b.stamps)[: len(rows_b)]
    order = np.argsort(stamps_b, kind="stable")
    at = np.searchsorted(stamps_b[order], stamps_a - _SAME_TIME_NS)
    found = []
    for k in range(0, len(stamps_a), max(1, len(stamps_a) // 200)):
        if at[k] < len(order) and abs(stamps_b[order[at[k]]] - stamps_a[k]) <= _SAME_TIME_NS:
            found.append((tuple(rows_a[k]), tuple(rows_b[order[at[k]]])))
    return found
