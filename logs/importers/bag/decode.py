"""Messages of ROS out of their bytes, by the types of the file or else by the standard ones."""

from __future__ import annotations

import functools
import struct
from typing import Any

from slam.logs.errors import LogError, missing_extra
from slam.logs.importers.bag.channels import Channel

_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
_IDL_RULE = "=" * 80 + "\n"


class MalformedError(Exception):
    """A message is not what its type says."""


@functools.cache
def _standard_stores() -> dict[str, Any]:
    """Return the types that ROS comes with, by encoding; to make them takes half a second."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise LogError(missing_extra("reading ROS bags", "ros")) from error
    ros1 = get_typestore(Stores.ROS1_NOETIC)
    for kind in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):  # rosbags has them for ROS 2
        ros1.register(get_types_from_msg(_TRANSFORMS, kind))
    return {"cdr": get_typestore(Stores.ROS2_HUMBLE), "ros1": ros1}


class Decoder:
    """Deserialises messages; a channel whose definition is missing or bad gets the standard."""

    def __init__(self) -> None:
        """Load the standard types.

        Raises:
            LogError: rosbags is not installed.
        """
        _standard_stores()

    def __call__(self, channel: Channel, data: bytes) -> Any:
        """Return the message.

        Raises:
            MalformedError: by no type at hand it can be read.
        """
        for store in _stores_for(channel):
            try:
                if channel.encoding == "ros1":
                    return store.deserialize_ros1(data, channel.kind)
                return store.deserialize_cdr(data, channel.kind)
            except _damage():
                continue
        raise MalformedError


@functools.lru_cache(maxsize=64)
def _stores_for(channel: Channel) -> list[Any]:
    """Return the types to try, best first; to make them takes a tenth of a second."""
    from rosbags.typesys import Stores, get_typestore

    standard = _standard_stores()[channel.encoding]
    if not channel.definition:
        return [standard]
    try:
        # A definition may leave out the types within it, which are standard ones here.
        types = _closed(channel.kind, {**standard.fielddefs, **_parsed(channel)})
        if not _compatible(types, standard.fielddefs):
            return [standard]
        store = get_typestore(Stores.EMPTY)
        store.register(types)
    except _damage():
        return [standard]
    return [store, standard]


def _parsed(channel: Channel) -> dict[str, Any]:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if channel.format != "ros2idl":
        return dict(get_types_from_msg(channel.definition, channel.kind))
    types: dict[str, Any] = {}
    for part in channel.definition.split(_IDL_RULE):
        text = part.partition("\n")[2] if part.startswith("IDL: ") else part
        if text.strip():
            types.update(get_types_from_idl(text))
    return types


def _compatible(types: dict[str, Any], standard: dict[str, Any]) -> bool:
    """Whether every type has the fields that the standard one of its name has.

    A file may define more; where something is missing, the definition is damaged.
    """
    for name, (_, fields) in types.items():
        found = dict(fields)
        for field, kind in standard[name][1] if name in standard else ():
            if found.get(field) != kind:
                return False
    return True


def _closed(kind: str, types: dict[str, Any]) -> dict[str, Any]:
    """Return a type and those that it is made of: to register all of them takes half a second."""
    needed: dict[str, Any] = {}
    waiting = [kind]
    while waiting:
        name = waiting.pop()
        if name not in needed:
            needed[name] = types[name]
            waiting += [inner for _, field in types[name][1] for inner in _names_in(field)]
    return needed


def _names_in(field: Any) -> list[str]:
    """Return the types that a field refers to: by name, or as elements of a list."""
    from rosbags.interfaces import Nodetype

    node, about = field
    if node == Nodetype.NAME:
        return [about]
    return _names_in(about[0]) if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else []


def _damage() -> tuple[type[Exception], ...]:
    """What rosbags raises on bytes or definitions that are damaged."""
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    return (
        *(SerdeError, TypesysError, OSError, ValueError, LookupError, AssertionError),
        *(TypeError, AttributeError, EOFError, struct.error, OverflowError, MemoryError),
        RecursionError,
    )
