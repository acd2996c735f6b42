"""The protobuf types of our channels: Foxglove's, each with one field of ours, and our own.

A Foxglove viewer shows the known part.  What Foxglove's types cannot carry (the exact
heading behind a quaternion, a scan's angle step and reach) travels in the same message, in
a field `slam` numbered far above theirs, as protobuf allows: no second channel has to be
paired with the first, and the schema embedded in the file describes every field.

Field numbers are a contract with every log ever written: append, never renumber or reuse.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from foxglove_schemas_protobuf import (
    FrameTransform_pb2,
    Grid_pb2,
    LaserScan_pb2,
    Log_pb2,
    Odometry_pb2,
)
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto

PACKAGE = "slam.v1"
OUR_FIELD = 1000  # Foxglove numbers its fields from 1 and uses fewer than twenty

_TYPES = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "int64": FieldDescriptorProto.TYPE_INT64,
    "bool": FieldDescriptorProto.TYPE_BOOL,
    "string": FieldDescriptorProto.TYPE_STRING,
}

# name, type ("double..." is repeated); a field's number is its place, counted from 1
_FIELDS: dict[str, tuple[tuple[str, str], ...]] = {
    "ScanDetail": (
        ("angle_step", "double"),
        ("range_min", "double"),
        ("range_max", "double"),
        ("beam_period_s", "double"),
    ),
    "PoseDetail": (("theta", "double"), ("lost", "bool")),
    "GridDetail": (("rows", "int64"),),
    "KeyframeDecision": (
        ("index", "int64"),
        ("scan_index", "int64"),
        ("reason", "string"),
        ("axis", "string"),
        ("travelled_m", "double"),
        ("turned_rad", "double"),
        ("interval_m", "double"),
        ("t_pe", "double"),
        ("sums", "double..."),
        ("achieved_sigmas", "double..."),
    ),
    "FactorRecord": (
        ("kind", "string"),
        ("i", "int64"),
        ("j", "int64"),
        ("x", "double"),
        ("y", "double"),
        ("theta", "double"),
        ("covariance", "double..."),
        ("used", "bool"),
        ("note", "string"),
    ),
    "LoopVerdict": (
        ("i", "int64"),
        ("j", "int64"),
        ("accepted", "bool"),
        ("reason", "string"),
        ("score", "double"),
        ("second_score", "double"),
        ("chi_square", "double"),
    ),
    "DeviceHealth": (
        ("device", "string"),
        ("link", "string"),
        ("names", "string..."),
        ("values", "string..."),
    ),
}

_FOXGLOVE: dict[str, tuple[FileDescriptor, str]] = {
    "LaserScan": (LaserScan_pb2.DESCRIPTOR, "ScanDetail"),
    "Odometry": (Odometry_pb2.DESCRIPTOR, "PoseDetail"),
    "FrameTransform": (FrameTransform_pb2.DESCRIPTOR, "PoseDetail"),
    "Grid": (Grid_pb2.DESCRIPTOR, "GridDetail"),
    "Log": (Log_pb2.DESCRIPTOR, ""),
}
"""Foxglove's message, and ours that goes with it; empty where theirs says it all."""


def _own_file(name: str) -> FileDescriptorProto:
    """Describe one of our messages in a file of its own.

    Single fields are `optional`, so that a zero, a minus zero and an absent one differ.
    """
    file = FileDescriptorProto(name=f"slam/v1/{name}.proto", package=PACKAGE, syntax="proto3")
    message = file.message_type.add(name=name)
    for number, (field_name, kind) in enumerate(_FIELDS[name], start=1):
        field = message.field.add(name=field_name, number=number)
        field.type = _TYPES[kind.removesuffix("...")]
        if kind.endswith("..."):
            field.label = FieldDescriptorProto.LABEL_REPEATED
            continue
        field.label = FieldDescriptorProto.LABEL_OPTIONAL
        field.proto3_optional = True
        field.oneof_index = len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{field_name}")
    return file


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
    files = descriptor_pb2.FileDescriptorSet(file=_files_of(name).values())
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
    return tuple(field_name for field_name, _ in _FIELDS[name])
