"""Messages to bytes and back, and the MCAP channel that each kind of message lives on.

Every field survives to the last bit (a signalling nan becomes a quiet one).  The stamp is
the MCAP message's publish time; the viewer's copy inside the payload is never read back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import DecodeError
from slam.logs import foxglove, protos
from slam.logs.messages import (
    DeviceHealth,
    FactorRecord,
    FrameTransform,
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    LoopResult,
    Message,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    TruePose,
    WheelOdometry,
)

STAMP_LIMIT = 2**63
"""Stamps are nanoseconds of UTC from 1970 on, below this: they fit int64 and MCAP's uint64."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic, what is written on it, and how."""

    topic: str
    message: str  # name of the protobuf message, "" for bytes without a schema
    encode: Callable[[Any], bytes]
    decode: Callable[[int, bytes], Message]  # stamp in ns and payload; raises ValueError

    @property
    def schema_name(self) -> str:
        """The name of the MCAP schema, empty where there is none."""
        return protos.full_name(self.message) if self.message else ""

    @property
    def encoding(self) -> str:
        """The MCAP message encoding."""
        return "protobuf" if self.message else ""


def _raw(topic: str, device: Any, direction: Any) -> Channel:
    def decode(stamp_ns: int, data: bytes) -> RawBytes:
        return RawBytes(stamp_ns, device, direction, data)

    def encode(message: RawBytes) -> bytes:
        return message.data

    return Channel(topic, "", encode, decode)


def _own(topic: str, name: str, kind: Callable[..., Any]) -> Channel:
    """Return the channel of a message of plain fields, written under their own names.

    `name` is that of the protobuf message, which stays when the class is renamed.
    """
    fields = protos.field_names(name)
    cls = protos.CLASSES[name]

    def encode(message: Any) -> bytes:
        payload: bytes = cls(**{f: getattr(message, f) for f in fields}).SerializeToString()
        return payload

    def decode(stamp_ns: int, data: bytes) -> Message:
        read = cls.FromString(data)
        values = {f: getattr(read, f) for f in fields}
        for field, value in values.items():
            if not isinstance(value, int | float | str):
                values[field] = tuple(value)
        _UPGRADES.get(name, _as_it_is)(values)
        if problem := _FLAWS.get(name, _no_flaw)(values):
            raise ValueError(problem)
        message: Message = kind(stamp_ns=stamp_ns, **values)
        return message

    return Channel(topic, name, encode, decode)


def _as_it_is(values: dict[str, Any]) -> None:
    pass


def _split_sums(values: dict[str, Any]) -> None:
    """Give predicted sigmas their own field: older logs hold them in place of the four sums."""
    if len(values["sums"]) == _SIGMAS and not values["predicted_sigmas"]:
        values["predicted_sigmas"], values["sums"] = values["sums"], ()


def _no_flaw(values: dict[str, Any]) -> str:
    return ""


def _factor_flaw(values: dict[str, Any]) -> str:
    return "" if values["kind"] in _FACTOR_KINDS else "unknown kind of factor"


def _health_flaw(values: dict[str, Any]) -> str:
    matched = len(values["names"]) == len(values["values"])
    return "" if matched else "names and values of unequal number"


_SIGMAS = 3  # x, y, theta
_UPGRADES = {"KeyframeDecision": _split_sums}
"""How fields that an older program wrote become those of today."""

_FACTOR_KINDS = ("prior", "odometry", "icp", "loop")
_FLAWS = {"FactorRecord": _factor_flaw, "DeviceHealth": _health_flaw}
"""What the fields of a message must not be, beside what the schema says."""

_ALL = (
    Channel("/scan", "LaserScan", foxglove.encode_scan, foxglove.decode_scan),
    Channel("/odom", "Odometry", foxglove.encode_odometry, foxglove.decode_odometry),
    Channel("/tf", "FrameTransform", foxglove.encode_tf, foxglove.decode_mount),
    Channel("/truth", "Odometry", foxglove.encode_truth, foxglove.decode_truth),
    Channel("/pose", "Odometry", foxglove.encode_pose, foxglove.decode_pose),
    Channel("/map", "Grid", foxglove.encode_map, foxglove.decode_map),
    _own("/keyframe", "KeyframeDecision", KeyframeDecision),
    _own("/factor", "FactorRecord", FactorRecord),
    _own("/loop", "LoopVerdict", LoopResult),
    Channel("/log", "Log", foxglove.encode_log, foxglove.decode_log),
    _own("/diagnostics", "DeviceHealth", DeviceHealth),
    _raw("/raw/p3dx/rx", "p3dx", "rx"),
    _raw("/raw/p3dx/tx", "p3dx", "tx"),
    _raw("/raw/laser/rx", "laser", "rx"),
    _raw("/raw/laser/tx", "laser", "tx"),
)

CHANNELS = {channel.topic: channel for channel in _ALL}
"""Every channel of ours, by topic."""

_TOPICS: dict[type, str] = {
    LaserScan: "/scan",
    WheelOdometry: "/odom",
    LaserExtrinsics: "/tf",
    FrameTransform: "/tf",
    TruePose: "/truth",
    PoseEstimate: "/pose",
    OccupancyMap: "/map",
    KeyframeDecision: "/keyframe",
    FactorRecord: "/factor",
    LoopResult: "/loop",
    LogLine: "/log",
    DeviceHealth: "/diagnostics",
}


def topic_of(message: Message) -> str:
    """Return the topic that a message is written on."""
    if isinstance(message, RawBytes):
        return f"/raw/{message.device}/{message.direction}"
    return _TOPICS[type(message)]


def encode(message: Message) -> bytes:
    """Return a message as the payload of its channel.

    Raises:
        ValueError: if a field holds what the format cannot (an integer beyond 64 bits,
            text that is no Unicode, a covariance that is not 9 numbers or none).
    """
    return CHANNELS[topic_of(message)].encode(message)


def decode(topic: str, stamp_ns: int, data: bytes) -> Message:
    """Return the message that a payload on one of our topics holds.

    Raises:
        ValueError: if the payload is not what the topic's schema says.
    """
    try:
        return CHANNELS[topic].decode(stamp_ns, data)
    except DecodeError as error:
        raise ValueError(f"not a {CHANNELS[topic].schema_name}") from error
