"""`slam info` of a recording of other programs: what is in it, and what an import would take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.decode import Decoder
from slam.logs.importers.bag.files import Bag
from slam.logs.importers.bag.frames import Link
from slam.logs.importers.bag.inventory import Inventory, Stream, take_inventory
from slam.logs.importers.bag.plan import choose
from slam.logs.importers.bag.transforms import planar
from slam.logs.importers.detect import read_any
from slam.logs.importers.wishes import Wishes, mount_in_words
from slam.logs.messages import LaserScan, WheelOdometry

_MOST = 60  # topics or transforms that are listed


def describe_foreign(path: Path) -> Iterator[str]:
    """Yield lines about a recording of ROS, or a log of another kind.

    Raises:
        LogError: it cannot be read.
    """
    try:
        bag = Bag(path)
    except LogError:
        yield from _describe_text(path)
        return
    try:
        yield from _describe_bag(path, take_inventory(bag, Decoder()))
    except LogError as error:
        prefix = "" if str(error).startswith(str(path)) else f"{path}: "
        raise type(error)(f"{prefix}{error}") from error


def _describe_text(path: Path) -> Iterator[str]:
    log = read_any(path)
    messages = [message for message, _ in log.received()]
    kinds = Counter(type(message) for message in messages)
    seconds = (messages[-1].stamp_ns - messages[0].stamp_ns) * 1e-9
    yield (
        f"{path}: {log.kind}, {kinds[LaserScan]} scans and {kinds[WheelOdometry]} odometry "
        f"messages in {seconds:.1f} s"
    )
    for text in (*log.notes, *log.warnings):
        yield f"  {text}"
    for counts in (log.skipped, log.changed, log.ignored):
        yield from (f"  {count} x {cause}" for cause, count in counts.items())


def _describe_bag(path: Path, found: Inventory) -> Iterator[str]:
    seconds = (found.last_ns - found.first_ns) * 1e-9
    yield f"{path}: ROS recording, {sum(found.counts.values())} messages in {seconds:.1f} s"
    listed = sorted(found.counts.items(), key=lambda item: item[0].topic)
    for channel, count in listed[:_MOST]:
        stream = found.streams.get((channel.topic, channel.kind))
        kind = shown(channel.kind or channel.where)
        rate = _rate(stream, count, seconds)
        yield f"  {shown(channel.topic):<28} {count:>8} {rate:>10}  {kind}{_frames(stream)}"
    if len(listed) > _MOST:
        yield f"  ... and {len(listed) - _MOST} more topics"
    yield from _transforms(found)
    for cause, count in (found.skipped + found.changed).items():
        yield f"  {count} x {cause}"
    try:
        said = choose(found, Wishes()).said
    except LogError as error:
        yield f"  import: {error}"
        return
    yield f"  import: {', '.join(said.notes)}"
    for warning in said.warnings:
        yield f"  import would warn: {warning}"


def _rate(stream: Stream | None, count: int, seconds: float) -> str:
    """The rate by the stamps, or by the times of receipt where nothing else is known."""
    for times in stream.arrays() if stream is not None else ():
        steps = np.diff(times)
        if (steps > 0).any():
            return f"{1e9 / float(np.median(steps[steps > 0])):.2f} Hz"
    return f"{(count - 1) / seconds:.2f} Hz" if count > 1 and seconds > 0 else ""


def _frames(stream: Stream | None) -> str:
    if stream is None:
        return ""
    frame = shown(stream.frame) or "no frame"
    child = f" -> {shown(stream.child) or 'no frame'}" if stream.children else ""
    more = f" and {len(stream.frames) - 1} more frames" if len(stream.frames) > 1 else ""
    return f", {frame}{child}{more}"


def _transforms(found: Inventory) -> Iterator[str]:
    links = sorted(found.tree.links.values(), key=lambda n: (n.parent, n.child))
    if links:
        yield "  transforms:"
    for link in links[:_MOST]:
        yield f"    {shown(link.parent)} -> {shown(link.child)}: {_place(link)}"
    if len(links) > _MOST:
        yield f"    ... and {len(links) - _MOST} more"
    if found.tree.refused:
        yield f"    {found.tree.refused} are no transforms: not finite, or without a rotation"


def _place(link: Link) -> str:
    topic = "/tf_static" if link.static else "/tf"
    if link.contradicts_itself:
        values = " and ".join(mount_in_words(*planar(value)[:3]) for value in link.values)
        return f"{values}, {topic}"
    if not link.fast:
        return f"moves, {link.count} times on {topic}"
    return f"{mount_in_words(*planar(link.last)[:3])}, {topic}"
