"""Hypothesis strategies for every message, and equality to the last bit."""

from __future__ import annotations

import struct
from dataclasses import fields

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.logs.messages import (
    DeviceHealth,
    FactorRecord,
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LogLine,
    LoopResult,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    TruePose,
    WheelOdometry,
)

stamps = st.integers(0, 2**63 - 1)
numbers = st.floats(allow_nan=True, allow_infinity=True)
integers = st.integers(-(2**63), 2**63 - 1)
texts = st.text(max_size=40)
nine = st.tuples(*[numbers] * 9)
lists = st.lists(numbers, max_size=6).map(tuple)
wall_sums = st.one_of(st.just(()), st.tuples(*[numbers] * 4))


def quiet(ranges: np.ndarray) -> np.ndarray:
    """Turn signalling nans into quiet ones, as any computation with them would."""
    with np.errstate(invalid="ignore"):
        return ranges.astype(np.float64).astype(np.float32)


ranges = npst.arrays(
    np.float32,
    st.integers(0, 60),
    elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
).map(quiet)

scans = st.builds(LaserScan, stamps, numbers, numbers, ranges, numbers, numbers, numbers)
cells = npst.arrays(np.int8, st.tuples(st.integers(0, 9), st.integers(0, 9)))
planar = (stamps, numbers, numbers, numbers)

messages = st.one_of(
    scans,
    st.builds(WheelOdometry, *planar),
    st.builds(LaserExtrinsics, *planar),
    st.builds(TruePose, *planar),
    st.builds(
        RawBytes, stamps, st.sampled_from(["p3dx", "laser"]), st.sampled_from(["rx", "tx"]),
        st.binary(max_size=80),
    ),
    st.builds(PoseEstimate, *planar, st.one_of(st.just(()), nine), st.booleans()),
    st.builds(
        KeyframeDecision, stamps, integers, integers, texts, texts, numbers, numbers, numbers,
        numbers, wall_sums, lists, lists,
    ),
    st.builds(
        FactorRecord, stamps, st.sampled_from(["prior", "odometry", "icp", "loop"]), integers,
        integers, numbers, numbers, numbers, nine, st.booleans(), texts,
    ),
    st.builds(
        LoopResult, stamps, integers, integers, st.booleans(), texts, numbers, numbers, numbers
    ),
    st.builds(
        LogLine, stamps, st.sampled_from(["debug", "info", "warning", "error", "fatal"]), texts,
        texts,
    ),
    st.builds(
        lambda stamp, device, link, pairs: DeviceHealth(
            stamp, device, link, tuple(n for n, _ in pairs), tuple(v for _, v in pairs)
        ),
        stamps, texts, texts, st.lists(st.tuples(texts, texts), max_size=4),
    ),
    st.builds(OccupancyMap, stamps, numbers, numbers, numbers, cells),
)  # fmt: skip


def bits(value: object) -> object:
    """Return something that is equal only for values that are the same in every bit."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(bits(item) for item in value)
    return value


def content(message: object) -> tuple[object, ...]:
    """Return type and bits of all fields."""
    names = [field.name for field in fields(message)]  # type: ignore[arg-type]
    return (type(message), *(bits(getattr(message, name)) for name in names))
