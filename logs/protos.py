"""The protobuf types of our channels: Foxglove's, each with one field of ours, and our own.

A Foxglove viewer shows the known part.  What Foxglove's types cannot carry (the exact
heading behind a quaternion, a scan's angle step and reach) travels in the same message, in
a field `slam` numbered far above theirs, as protobuf allows: no second channel has to be
paired with the first, and the schema embedded in the file describes every field.

Our messages are described in `slam.proto`, for people and other programs, and loaded from the
compiled form beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf import (
    FrameTransform_pb2,
    Grid_pb2,
    LaserScan_pb2,
    Log_pb2,
    Odometry_pb2,
)
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)

PACKAGE = "slam.v1"
OUR_FIELD = 1000  # Foxglove numbers its fields from 1 and uses fewer than twenty

_COMPILED = Path(__file__).with_name("slam.binpb")
"""`slam.proto` as a FileDescriptorSet: it loads in a millisecond and needs no compiler."""

_FOXGLOVE: dict[str, tuple[FileDescriptor, str]] = {
    "LaserScan": (LaserScan_pb2.DESCRIPTOR, "ScanDetail"),
    "Odometry": (Odometry_pb2.DESCRIPTOR, "PoseDetail"),
    "FrameTransform": (FrameTransform_pb2.DESCRIPTOR, "PoseDetail"),
    "Grid": (Grid_pb2.DESCRIPTOR, "GridDetail"),
    "Log": (Log_pb2.DESCRIPTOR, ""),
}
"""Foxglove's message, and ours that goes with it; empty where theirs says it all."""


def _own_messages() -> dict[str, DescriptorProto]:
    """Read the descriptions of our messages, by name.

    Raises:
        OSError: if the program is installed without `slam.binpb`.
    """
    (file,) = FileDescriptorSet.FromString(_COMPILED.read_bytes()).file
    for message in file.message_type:
        for field in message.field:
            field.ClearField("json_name")  # the compiler's guess, in no schema of our logs
    return {message.name: message for message in file.message_type}


_OWN = _own_messages()


def _own_file(name: str) -> FileDescriptorProto:
    """Describe one of our messages in a file of its own: a log holds only what it needs."""
    return FileDescriptorProto(
        name=f"slam/v1/{name}.proto", package=PACKAGE, syntax="proto3", message_type=[_OWN[name]]
    )


def _copy(source: FileDescriptor) -> FileDescriptorProto:
    file = FileDescriptorProto()
    source.CopyToProto(file)
    return file


def _extended_file(name: str) -> FileDescriptorProto:
    """Describe one of Foxglove's messages with our detail in its field `slam`."""
    source, detail = _FOXGLOVE[name]
    file = _copy(source)
    file.dependency.append(f"slam/v1/{detail}.proto")
    file.message_type[0].field.add(
        name="slam",
        number=OUR_FIELD,
        label=FieldDescriptorProto.LABEL_OPTIONAL,
        type=FieldDescriptorProto.TYPE_MESSAGE,
        type_name=f".{PACKAGE}.{detail}",
    )
    return file


def _dependencies(source: FileDescriptor, into: dict[str, FileDescriptorProto]) -> None:
    """Add the files that `source` imports, each after those that it imports itself."""
    for needed in source.dependencies:
        _dependencies(needed, into)
        if needed.name not in into:
            into[needed.name] = _copy(needed)


def _files_of(name: str) -> dict[str, FileDescriptorProto]:
    """Return every file that the message needs, by name, dependencies first."""
    files: dict[str, FileDescriptorProto] = {}
    if name in _FOXGLOVE:
        source, detail = _FOXGLOVE[name]
        _dependencies(source, files)
        for file in (_own_file(detail), _extended_file(name)) if detail else (_copy(source),):
            files[file.name] = file
    else:
        own = _own_file(name)
        files[own.name] = own
    return files


def full_name(name: str) -> str:
    """Return the message's name with its package, which is also its MCAP schema name."""
    return f"foxglove.{name}" if name in _FOXGLOVE else f"{PACKAGE}.{name}"


def descriptor_set(name: str) -> bytes:
    """Return the serialized FileDescriptorSet that MCAP embeds as the message's schema."""
    files = FileDescriptorSet(file=_files_of(name).values())
    return files.SerializeToString(deterministic=True)


def _classes(names: Iterable[str]) -> Mapping[str, Any]:
    """Build the message classes that our codecs use.

    The scan's `ranges` are declared as bytes here: on the wire a packed list of doubles and
    a byte string are the same, and numpy reads the bytes without touching each element.
    """
    files: dict[str, FileDescriptorProto] = {}
    for name in names:
        files.update(_files_of(name))
    for field in files["foxglove/LaserScan.proto"].message_type[0].field:
        if field.name == "ranges":
            field.type = FieldDescriptorProto.TYPE_BYTES
            field.label = FieldDescriptorProto.LABEL_OPTIONAL
    pool = descriptor_pool.DescriptorPool()
    for file in files.values():
        pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(full_name(name)))
        for name in names
    }


OWN_NAMES = ("KeyframeDecision", "FactorRecord", "LoopVerdict", "DeviceHealth")
CLASSES = _classes((*_FOXGLOVE, *OWN_NAMES))


def field_names(name: str) -> tuple[str, ...]:
    """Return the field names of one of our own messages, in the order of their numbers."""
    return tuple(field.name for field in _OWN[name].field)
