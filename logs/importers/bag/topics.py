"""Which scans to read, and which odometry belongs to them: choices without files."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.frames import FrameTree, Link
from slam.logs.importers.bag.inventory import ODOMETRY, SCAN, SCANS, Inventory, Stream
from slam.logs.importers.bag.names import is_odom, is_world, leaf, plain, prefix
from slam.logs.importers.bag.odometry import Odometry, from_link, from_stream
from slam.logs.importers.wishes import Wishes

NO_ODOMETRY = "none"  # as a wish: laser alone
_SEEING_WORDS = frozenset(
    "visual vo vio vins camera zed zed2 stereo realsense t265 rtabmap orb icp lidar laser rf2o "
    "matcher kiss".split()
)
_TRUTH_WORDS = {
    *("truth", "groundtruth", "gt", "ground", "true", "mocap", "vicon", "optitrack", "qualisys"),
    *("amcl", "gps", "gnss", "global", "slam", "map", "localization", "localisation", "perfect"),
}
"""Words in topics that hold poses of a simulator, a survey, or a localiser."""

_USUAL = ("odom", "odometry")
_LISTED = 8  # names in one line


@dataclass(slots=True)
class Said:
    """What was chosen, and what of it was a guess or goes against the recording."""

    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def choose_scan(inventory: Inventory, wishes: Wishes, said: Said) -> Stream:
    """Return the scans to read: those asked for, else `/scan`, else those with most messages.

    Raises:
        LogError: there are none, or none on the topic asked for.
    """
    candidates = inventory.of(*SCANS)
    if wishes.scan:
        asked = [s for s in candidates if plain(s.topic) == plain(wishes.scan)]
        if not asked:
            names = listed(s.topic for s in candidates) or "none"
            raise LogError(
                f"holds no LaserScan on {shown(wishes.scan)}: name another topic with --scan "
                f"(there are: {names})"
            )
        return asked[0]
    usable = [s for s in candidates if s.count > len(s.flaws)]
    if not usable:
        raise LogError(_no_scan(inventory, candidates))
    chosen, *others = sorted(usable, key=_scan_rank)
    rivals = [s for s in others if not _surely(chosen, s)]
    if rivals:
        said.warnings.append(
            f"scans on several topics: {shown(chosen.topic)} is taken, "
            f"--scan takes another ({listed(s.topic for s in rivals)})"
        )
    return chosen


def _scan_rank(stream: Stream) -> tuple[object, ...]:
    usable = stream.count - len(stream.flaws)
    return (plain(stream.topic) != "scan", stream.kind != SCAN, -usable, stream.topic)


def _surely(chosen: Stream, other: Stream) -> bool:
    """Whether scans are the ones meant, by the name that everybody gives them."""
    if plain(chosen.topic) == "scan":
        return True
    usual = leaf(chosen.topic) == "scan" and leaf(other.topic) != "scan"
    return usual and prefix(chosen.topic) == prefix(other.topic)


def _no_scan(inventory: Inventory, candidates: list[Stream]) -> str:
    causes = inventory.skipped.copy()
    for stream in candidates:
        causes.update(stream.flaws.values())
    if causes:
        cause, count = causes.most_common(1)[0]
        return f"no usable scan: {count} x {cause}"
    held = listed(f"{c.topic} ({c.kind or c.where})" for c in inventory.counts)
    return "holds no sensor_msgs/LaserScan" + (f", only {held}" if held else "")


def choose_odometry(
    inventory: Inventory, wishes: Wishes, scan: Stream, said: Said
) -> Odometry | None:
    """Return the odometry of the scans' own robot; never a truth or another robot's unasked.

    Raises:
        LogError: what was asked for is not there.
    """
    tree, streams = inventory.tree, inventory.of(ODOMETRY)
    if wishes.odometry == NO_ODOMETRY:
        return None
    if wishes.odometry:
        return _asked(tree, streams, wishes.odometry, scan)
    usable = [s for s in streams if s.count > len(s.flaws)]
    own = [s for s in usable if not is_truth(s) and not is_foreign(s, scan, inventory)]
    passed_over = [s for s in usable if s not in own]
    if own:
        chosen, *others = sorted(own, key=lambda s: _odometry_rank(s, scan, tree))
        if is_world(chosen.frame):
            said.warnings.append(
                f"odometry from {shown(chosen.topic)} is counted in {shown(chosen.frame)}: "
                "is it a localiser's or a truth? --odom takes another"
            )
        elif others and not _surely_odometry(chosen, others[0], scan):
            said.warnings.append(
                f"odometry on several topics: {shown(chosen.topic)} is taken, --odom takes "
                f"another ({listed(s.topic for s in others)})"
            )
        return from_stream(chosen)
    link = transform_odometry(tree, scan.frame, said)
    if streams and not usable:
        causes = listed({cause for stream in streams for cause in stream.flaws.values()})
        said.warnings.append(
            f"no message of {listed(s.topic for s in streams)} can be used as odometry: {causes}"
        )
    if passed_over and link is None:
        said.warnings.append(
            f"{listed(s.topic for s in passed_over)} looks like a truth or belongs to another "
            "robot, and is not taken as odometry: --odom takes it"
        )
    return None if link is None else from_link(link)


def _surely_odometry(chosen: Stream, other: Stream, scan: Stream) -> bool:
    """Whether odometry is the one meant, by its name and whose scans it stands beside."""
    if plain(chosen.topic) == "odom":
        return True
    usual = leaf(plain(chosen.topic)) in _USUAL
    if prefix(chosen.topic) == prefix(scan.topic) != prefix(other.topic):
        return usual
    alike = leaf(plain(chosen.topic)) == leaf(plain(other.topic))
    return usual and (not alike or is_seen(other) > is_seen(chosen))


def is_seen(stream: Stream) -> bool:
    """Whether odometry comes from cameras or lasers rather than wheels, by its topic's name."""
    return bool(_SEEING_WORDS & set(re.split(r"[/_\-.]", stream.topic.lower())))


def _asked(tree: FrameTree, streams: list[Stream], asked: str, scan: Stream) -> Odometry | None:
    for stream in streams:
        if plain(stream.topic) == plain(asked):
            return from_stream(stream)
    if plain(asked) in ("tf",) and (link := transform_odometry(tree, scan.frame, Said())):
        return from_link(link)
    parent, arrow, child = asked.replace("->", ">").partition(">")
    found = tree.links.get((plain(parent), plain(child))) if arrow else None
    if found is not None and found.stamps:
        return from_link(found)
    links = (f"{n.parent}>{n.child}" for n in tree.links.values() if n.stamps and not n.fast)
    names = listed([*(s.topic for s in streams), *links]) or "nothing of the kind"
    raise LogError(f"holds no odometry on {shown(asked)}: --odom may be one of {names}, or `none`")


def is_truth(stream: Stream) -> bool:
    """Whether odometry is a simulator's or a survey's, by the name of its topic."""
    return bool(_TRUTH_WORDS & set(re.split(r"[/_\-.]", stream.topic.lower())))


def is_foreign(stream: Stream, scan: Stream, inventory: Inventory) -> bool:
    """Whether odometry belongs to another robot than the scans."""
    tree, laser = inventory.tree, scan.frame
    if stream.child and stream.child in tree.fast_with(laser):
        return False
    own, other = prefix(laser), prefix(stream.child)
    if own and other and own != other:
        return True
    here, there = _first_part(scan.topic), _first_part(stream.topic)
    if here == there:
        return False
    if here and there and re.sub(r"\d+", "", here) == re.sub(r"\d+", "", there):
        return True
    neighbours = {_first_part(s.topic) for s in inventory.of(*SCANS)}
    return bool(there) and there in neighbours


def _first_part(topic: str) -> str:
    return plain(topic).partition("/")[0] if "/" in plain(topic) else ""


def _odometry_rank(stream: Stream, scan: Stream, tree: FrameTree) -> tuple[object, ...]:
    usable = stream.count - len(stream.flaws)
    name = leaf(plain(stream.topic))
    return (
        is_world(stream.frame),
        is_seen(stream),
        prefix(stream.topic) != prefix(scan.topic),
        plain(stream.topic) != "odom",
        _USUAL.index(name) if name in _USUAL else len(_USUAL),
        stream.child not in tree.fast_with(scan.frame),
        -usable,
        stream.topic,
    )


def transform_odometry(tree: FrameTree, laser: str, said: Said) -> Link | None:
    """Return the link of /tf over which the laser's robot moves, None if there is none.

    A link from the building's frame is a localiser's and is left alone.
    """
    links = _links_to(tree, tree.fast_with(laser))
    if links and not is_odom(links[0].parent):
        # A laser that turns on the robot: the odometry is what moves the frame that it turns on.
        above = [n for link in links for n in _links_to(tree, tree.fast_with(link.parent))]
        links = [link for link in above if is_odom(link.parent)] or links
    if not links:
        return None
    chosen = links[0]
    others = [link for link in links[1:] if is_odom(link.parent) == is_odom(chosen.parent)]
    if not is_odom(chosen.parent) or others:
        names = listed(f"{link.parent}>{link.child}" for link in links[1:])
        more = f": --odom takes another ({names})" if names else "; --odom none leaves it out"
        said.warnings.append(
            f"the transform {shown(chosen.parent)} -> {shown(chosen.child)} is taken as "
            f"odometry{more}"
        )
    return chosen


def _links_to(tree: FrameTree, robot: set[str]) -> list[Link]:
    """Return the links of /tf that may move a set of frames, most likely odometry first."""
    links = [
        link
        for link in tree.links.values()
        if link.child in robot and link.parent not in robot and link.stamps
        and not is_world(link.parent)
    ]  # fmt: skip
    return sorted(links, key=lambda n: (not is_odom(n.parent), -n.count, n.parent, n.child))


def listed(names: object) -> str:
    """Return some names, shown safely, and how many there are more."""
    texts = [shown(str(name)) for name in names]  # type: ignore[attr-defined]
    more = f" and {len(texts) - _LISTED} more" if len(texts) > _LISTED else ""
    return ", ".join(texts[:_LISTED]) + more
