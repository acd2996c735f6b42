"""What every container of ROS messages gives: channels, and their messages in file order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic of one type."""

    topic: str
    kind: str  # as ROS 2 writes it: `sensor_msgs/msg/LaserScan`
    encoding: str  # "cdr", "ros1", or one that is none of ROS
    definition: str = ""  # text of the type, empty where the file has none
    format: str = ""  # of the definition: "ros2msg", "ros2idl", "ros1msg"
    where: str = ""  # other than the encoding, what the file calls the type's language

    @property
    def is_ros(self) -> bool:
        """Whether its messages are serialised as ROS does it."""
        return self.encoding in ("cdr", "ros1")


class BagMessage(NamedTuple):
    """A message as the container holds it."""

    channel: Channel
    receipt_ns: int
    data: bytes


Wanted = Callable[[Channel], bool]


class Container(Protocol):
    """A file of messages that can be read again and again."""

    kind: str  # for people: "ROS 2 bag (MCAP)"

    def messages(self, wanted: Wanted, account: Account) -> Iterator[BagMessage]:
        """Yield the wanted messages in file order; all are counted.

        Raises:
            LogError: if the file cannot be read at all.
        """
        ...


class Account:
    """What was met on the way through a container."""

    def __init__(self) -> None:
        self.counts: Counter[Channel] = Counter()  # messages, wanted or not
        self.skipped: Counter[str] = Counter()  # what could not be read, per cause
        self.changed: Counter[str] = Counter()  # what was read in spite of a defect


def ros2_name(kind: str) -> str:
    """Return a type's name as ROS 2 writes it: `sensor_msgs/LaserScan` is ROS 1's."""
    package, _, name = kind.partition("/")
    return kind if not name or name.startswith(("msg/", "srv/")) else f"{package}/msg/{name}"
