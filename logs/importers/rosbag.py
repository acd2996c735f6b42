"""ROS 1 bags and ROS 2 bags (MCAP or sqlite): scans, odometry, and where the laser sits.

A first pass takes an inventory of topics, frames, transforms and stamps (`bag.inventory`);
`bag.plan` chooses from it, without files, what is read; a second pass streams the scans, so
that a recording is never held.  Rules for what a recording leaves open:

- scans: the topic asked for, else `/scan`, else the one with most messages;
- odometry: of the scans' own robot and no truth, from a topic or else from `/tf`; none at
  all is no error (`bag.topics`);
- the mount: the chain of transforms from the odometry's base frame, or one named so, to the
  scans' frame; a laser that hangs upside down has its beams mirrored (`bag.mounts`);
- stamps are those of the headers, or the times of receipt where a header has none; stamps
  that step back by more than a second begin another drive (`bag.clocks`);
- ranges follow REP 117: inf is "nothing came back", also from `range_max` on; -inf (too
  near), nan, and readings nearer than `range_min` become nan.

A choice that had to be guessed is a warning.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from slam.logs.errors import LogError, shown
from slam.logs.importers.bag.channels import Account, Channel
from slam.logs.importers.bag.decode import Decoder, MalformedError
from slam.logs.importers.bag.files import Bag
from slam.logs.importers.bag.inventory import READ, SCANS, Inventory, take_inventory
from slam.logs.importers.bag.plan import DROPPED, Plan, make_plan
from slam.logs.importers.bag.scans import mirrored, scan_of
from slam.logs.importers.imported import StreamedLog
from slam.logs.importers.wishes import Wishes
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, WheelOdometry

_NO_WISHES = Wishes()


def read_rosbag(path: Path | str, wishes: Wishes = _NO_WISHES) -> StreamedLog:
    """Look through a bag; its messages are then read in stamp order, however large it is.

    `path` is a .bag, .mcap or .db3 file or a folder.

    Raises:
        LogError: if it cannot be read, holds no usable scan, cannot be read without an
            answer in `wishes`, or rosbags is not installed.
    """
    path = Path(path)
    try:
        decode = Decoder()
        bag = Bag(path)
        inventory = take_inventory(bag, decode)
        skipped, changed = inventory.skipped.copy(), inventory.changed.copy()
        plan = make_plan(inventory, wishes, skipped, changed)
    except LogError as error:
        if str(error).startswith(str(path)):
            raise
        raise type(error)(f"{path}: {error}") from error
    said = plan.choice.said
    if bag.lonely and any("no transform" in warning for warning in said.warnings):
        said.warnings.append(
            "the other parts of this recording may hold the transforms: name its folder"
        )

    def read() -> Iterator[tuple[SensorMessage, int]]:
        return _placed(bag, decode, plan)

    ignored = _ignored(inventory, plan)
    return StreamedLog("ROS bag", read, skipped, changed, ignored, said.notes, said.warnings)


def _ignored(inventory: Inventory, plan: Plan) -> Counter[str]:
    """Count the messages that are of no use here, by topic."""
    ignored: Counter[str] = Counter()
    choice = plan.choice
    used = {choice.scan.topic, choice.odometry.topic if choice.odometry else ""}
    for channel, count in inventory.counts.items():
        transforms = channel.kind in READ and channel.topic.rstrip("/").endswith(
            ("tf", "tf_static")
        )
        if (channel.topic in used and channel.kind in READ) or transforms:
            continue
        kind = "another laser" if channel.kind in SCANS else channel.kind or channel.where
        ignored[f"{shown(channel.topic)} ({shown(kind)})"] += count
    return ignored


def _scans(bag: Bag, decode: Decoder, plan: Plan) -> Iterator[tuple[int, int, LaserScan]]:
    """Yield rank, time of receipt and scan in file order."""
    stream, number = plan.choice.scan, -1
    upside_down = plan.choice.mount.upside_down

    def wanted(channel: Channel) -> bool:
        return channel.is_ros and (channel.topic, channel.kind) == (stream.topic, stream.kind)

    for channel, receipt_ns, data in bag.messages(wanted, Account()):
        try:
            message = decode(channel, data)
        except MalformedError:
            continue
        number += 1
        if number == len(plan.scan_stamps):
            return  # a damaged database may give more the second time
        stamp_ns = int(plan.scan_stamps[number])
        if stamp_ns != DROPPED:
            scan = scan_of(message, stamp_ns)
            yield int(plan.scan_ranks[number]), receipt_ns, mirrored(scan) if upside_down else scan


def _placed(bag: Bag, decode: Decoder, plan: Plan) -> Iterator[tuple[SensorMessage, int]]:
    """Yield the mount, then all messages by rank; only scans that came too early are held."""
    mount = plan.choice.mount
    waiting: list[tuple[int, int, LaserScan]] = []  # a heap: rank, time of receipt, scan
    wheels = iter(plan.odometry)
    following = next(wheels, None)
    emitted = 0

    def ready() -> Iterator[tuple[WheelOdometry | LaserScan, int]]:
        nonlocal following, emitted
        while True:
            if following is not None and following[0] == emitted:
                _, receipt_ns, message = following
                following = next(wheels, None)
                yield message, receipt_ns
            elif waiting and waiting[0][0] == emitted:
                _, receipt_ns, scan = heapq.heappop(waiting)
                yield scan, receipt_ns
            else:
                return
            emitted += 1

    def everything() -> Iterator[tuple[WheelOdometry | LaserScan, int]]:
        nonlocal emitted
        for item in _scans(bag, decode, plan):
            heapq.heappush(waiting, item)
            yield from ready()
        while waiting or following is not None:
            yield from ready()
            ranks = [waiting[0][0]] if waiting else []
            ranks += [following[0]] if following is not None else []
            emitted = max(emitted, min(ranks, default=emitted))  # over scans that did not come

    for number, (message, receipt_ns) in enumerate(everything()):
        if number == 0:
            extrinsics = LaserExtrinsics(message.stamp_ns, mount.x, mount.y, mount.theta)
            yield extrinsics, receipt_ns
        yield message, receipt_ns
