"""Where the laser sits on the base: a choice without files.

The base is the frame asked for, else the one that the odometry moves, else one whose name
ends in base_link, base_footprint or base, of the laser's own robot.  The mount is the
chain of transforms from it to the scans' frame, taken as tf2 takes it: of several
statements about a frame that hold for good, the last one counts.
"""

from __future__ import annotations

import math

from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.frames import TILT_RAD, FrameTree, Link, along
from slam.logs.importers.bag.moving import HINT, meets, moves, moving_between, over_moving_links
from slam.logs.importers.bag.names import leaf, plain, prefix
from slam.logs.importers.bag.odometry import Odometry
from slam.logs.importers.bag.topics import Said, listed
from slam.logs.importers.bag.transforms import Mount, planar
from slam.logs.importers.wishes import Wishes, mount_in_words

BASE_NAMES = ("base_link", "base_footprint", "base", "base_frame", "robot_base", "chassis")


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
    known = odometry is None or laser in {odometry.child, plain(wishes.base)} - {""}
    if path is None or (base == laser and not known):
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
    if moved and ((path := tree.path(moved, laser)) is not None or meets(tree, moved, laser)):
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
    if base != laser and (steady := over_moving_links(tree, base, laser, said)):
        return steady
    if odometry is None:
        said.notes.append("no transform to the laser: the map is made from the laser's own place")
        return Mount(0.0, 0.0, 0.0)
    moving = moving_between(tree, base, laser)
    if moving is not None:
        raise LogError(moves(moving, base, laser))
    from_ = (base != laser and shown(base)) or "the base"
    frames = f"; frames: {listed(tree.frames)}" if tree.frames else ""
    said.warnings.append(
        f"no transform from {from_} to {shown(laser) or 'the laser'}: the "
        f"laser is taken to sit on it, which bends every turn if it does not: {HINT}{frames}"
    )
    return Mount(0.0, 0.0, 0.0)


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
