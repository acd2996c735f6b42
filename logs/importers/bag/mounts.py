"""Where the laser sits on the base: a choice without files.

The base is the frame asked for, else the one that the odometry moves, else one whose name
ends in base_link, base_footprint or base, of the laser's own robot.  The mount is the
chain of transforms from it to the scans' frame, taken as tf2 takes it: of several
statements about a frame that hold for good, the last one counts.
"""

from __future__ import annotations

import math

import numpy as np
from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.frames import (
    FAST_RAD,
    TILT_RAD,
    FrameTree,
    Link,
    Mount,
    along,
    leaf,
    plain,
    planar,
    prefix,
)
from slam.logs.importers.bag.topics import Odometry, Said, listed
from slam.logs.importers.wishes import Wishes, mount_in_words

BASE_NAMES = ("base_link", "base_footprint", "base", "base_frame", "robot_base", "chassis")
_Pose = tuple[float, float, float]

_HINT = "say --mount x,y,theta (m, m, rad)"
_SAME_TIME_NS = 1_000_000  # two links stamped no farther apart speak of one moment
_STEADY_M = 0.01  # a mount over moving links may vary by this, which rounding does


def choose_mount(
    tree: FrameTree, laser: str, odometry: Odometry | None, wishes: Wishes, said: Said
) -> tuple[str, Mount]:
    """Return the base frame and where the laser sits on it.

    Raises:
        LogError: the laser moves on the base, or programs contradict each other about it.
    """
    base, path = _base(tree, laser, odometry, wishes, said)
    if wishes.mount is not None:
        mount = planar(along(path, base)) if path else Mount(0.0, 0.0, 0.0)
        stated = mount._replace(x=wishes.mount[0], y=wishes.mount[1], theta=wishes.mount[2])
        hanging = ", hanging upside down as the transforms say" if stated.upside_down else ""
        said.notes.append(f"laser at {mount_in_words(*stated[:3])}, as --mount says{hanging}")
        return base or laser, stated
    stated = laser in (odometry.child, plain(wishes.base)) if odometry else True
    if path is None or (base == laser and not stated):
        return base, _without_path(tree, laser, base, odometry, said)
    mount = planar(along(path, base))
    _note_conflicts(tree, path, said)
    if base == laser:
        why = "the base is its own frame" if odometry else "the map is made from its own place"
        said.notes.append(f"laser at {mount_in_words(0.0, 0.0, 0.0)}: {why}")
    else:
        said.notes.append(
            f"laser at {mount_in_words(*mount[:3])} on {shown(base)}, from {_origin(path)}"
        )
    if mount.tilt > TILT_RAD:
        said.warnings.append(
            f"laser tilted by {math.degrees(mount.tilt):.0f} deg: its scans are taken as level"
        )
    return base, mount


def _base(
    tree: FrameTree, laser: str, odometry: Odometry | None, wishes: Wishes, said: Said
) -> tuple[str, list[Link] | None]:
    """Return the base frame, and the path from it to the laser if there is a fast one."""
    if wishes.base:
        base = _asked(tree, laser, odometry, wishes.base)
        return base, tree.path(base, laser)
    moved = odometry.child if odometry is not None else ""
    if moved and ((path := tree.path(moved, laser)) is not None or _meets(tree, moved, laser)):
        return moved, path
    robot = tree.fast_with(laser)
    named = [f for f in sorted(robot) if _base_rank(f, laser) is not None]
    if named:
        base = min(named, key=lambda f: (_base_rank(f, laser), f))
        if moved and wishes.mount is None and leaf(moved) != leaf(base):
            said.warnings.append(
                f"no transform leads from {shown(moved)}, which the odometry moves, to "
                f"{shown(laser)}: {shown(base)} is taken for it; --base or --mount say otherwise"
            )
        return base, tree.path(base, laser)
    root = _root(tree, laser)
    if root != laser and wishes.mount is None:
        others = listed(f for f in sorted(robot) if f not in (root, laser)) or "none"
        said.warnings.append(
            f"no frame is called base_link: {shown(root)} is taken for the base; --base takes "
            f"another ({others})"
        )
        return root, tree.path(root, laser)
    return moved or laser, None if moved else tree.path(laser, laser)


def _asked(tree: FrameTree, laser: str, odometry: Odometry | None, asked: str) -> str:
    frames = {*tree.frames, laser, *([odometry.child] if odometry else [])} - {""}
    if plain(asked) in frames:
        return plain(asked)
    ending = [frame for frame in sorted(frames) if leaf(frame) == plain(asked)]
    if len(ending) == 1:
        return ending[0]
    raise LogError(
        f"has no frame {shown(asked)} for --base: there are {listed(sorted(frames)) or 'none'}"
    )


def _base_rank(frame: str, laser: str) -> tuple[bool, int] | None:
    """Order names of bases, None for other names; of the laser's own robot first."""
    name = leaf(frame).lower()
    for rank, known in enumerate(BASE_NAMES):
        if name == known or (name.endswith(f"_{known}") and known != "base"):
            return prefix(frame) != prefix(laser), rank
    return None


def _root(tree: FrameTree, frame: str) -> str:
    """Return the frame at the top of the fast links above a frame."""
    parents = {link.child: link.parent for link in tree.fast_links()}
    seen = {frame}
    while (parent := parents.get(frame)) is not None and parent not in seen:
        frame = parent
        seen.add(frame)
    return frame


def _without_path(
    tree: FrameTree, laser: str, base: str, odometry: Odometry | None, said: Said
) -> Mount:
    """Find the mount where nothing fast leads from the base to the laser."""
    if base != laser and (steady := _over_moving_links(tree, base, laser, said)):
        return steady
    if odometry is None:
        said.notes.append("no transform to the laser: the map is made from the laser's own place")
        return Mount(0.0, 0.0, 0.0)
    moving = _moving_between(tree, base, laser)
    if moving is not None:
        raise LogError(_moves(moving, base, laser))
    from_ = (base != laser and shown(base)) or "the base"
    frames = f"; frames: {listed(tree.frames)}" if tree.frames else ""
    said.warnings.append(
        f"no transform from {from_} to {shown(laser) or 'the laser'}: the "
        f"laser is taken to sit on it, which bends every turn if it does not: {_HINT}{frames}"
    )
    return Mount(0.0, 0.0, 0.0)


def _moves(link: Link, base: str, laser: str) -> str:
    if link.contradicts_itself:
        values = " and ".join(mount_in_words(*planar(v)[:3]) for v in link.values)
        return (
            f"the transform {shown(link.parent)} -> {shown(link.child)} is sent as {values} by "
            f"turns: {_HINT}"
        )
    return (
        f"the laser moves on the robot: {shown(link.parent)} -> {shown(link.child)} between "
        f"{shown(base)} and {shown(laser)} changes by up to {link.spread_m:.2g} m and "
        f"{math.degrees(link.spread_rad):.0f} deg; a fixed laser is needed, or {_HINT}"
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


def _meets(tree: FrameTree, base: str, laser: str) -> bool:
    return _meeting(tree, base, laser) is not None


def _moving_between(tree: FrameTree, base: str, laser: str) -> Link | None:
    meeting = _meeting(tree, base, laser)
    links = [*meeting[0], *meeting[1]] if meeting else []
    return next((link for link in reversed(links) if not link.fast), None)


def _over_moving_links(tree: FrameTree, base: str, laser: str, said: Said) -> Mount | None:
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


def _climb(links: list[Link], moving: Link, pose: tuple[float, float, float]) -> np.ndarray:
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


def _note_conflicts(tree: FrameTree, path: list[Link], said: Said) -> None:
    for link in path:
        values = [value for other in (link, *tree.rivals(link)) for value in other.values]
        if not (link.contradicts_itself or len(tree.rivals(link))):
            continue
        places = " and ".join(mount_in_words(*planar(v)[:3]) for v in values)
        parents = sorted({link.parent, *(other.parent for other in tree.rivals(link))})
        said.warnings.append(
            f"{shown(link.child)} has several places on {listed(parents)}: {places}; "
            f"the last one sent counts, {mount_in_words(*planar(link.last)[:3])}; "
            "--mount says otherwise"
        )


def _origin(path: list[Link]) -> str:
    topics = sorted({"/tf_static" if link.static else "/tf" for link in path})
    return " and ".join(topics)
