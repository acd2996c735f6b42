"""Writes a golden file of today's schema; run once when channels or fields are added.

    python tests/logs/golden/make_golden.py tests/logs/golden/schema1-predicted.mcap

Old golden files stay: they prove that logs of that version can still be read.
"""

from __future__ import annotations

import hashlib
import sys
from itertools import islice
from pathlib import Path

import numpy as np
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import (
    DeviceHealth,
    FactorRecord,
    KeyframeDecision,
    LogLine,
    LoopResult,
    Message,
    OccupancyMap,
    PoseEstimate,
    RawBytes,
    TruePose,
)
from slam.logs.schemas import topic_of

from tests.logs.strategies import content

ADDED = {KeyframeDecision: ("predicted_sigmas",)}  # since the first golden file, in their order
COVARIANCE = (4e-4, 1e-6, 0.0, 1e-6, 9e-4, 0.0, 0.0, 0.0, 1e-5)


def digest(messages: list[Message]) -> str:
    """Return a SHA-256 over every bit of every field; names of classes do not count.

    A field that was added later (it has a default and stands last) counts only where it holds
    something: what is read from a file of before has the digest that was noted then.
    """
    told = [(topic_of(m), *_counted(m)) for m in messages]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def _counted(message: Message) -> tuple[object, ...]:
    values = content(message)[1:]
    for name in reversed(ADDED.get(type(message), ())):
        if getattr(message, name):
            break
        values = values[:-1]
    return values


def golden_messages() -> list[Message]:
    """Return a short simulated drive with one message at least of every kind."""
    messages: list[Message] = list(islice(simulate(scenario("testbed")), 30))
    for k, truth in enumerate([m for m in messages if isinstance(m, TruePose)]):
        pose = truth.x + 0.01, truth.y - 0.01, truth.theta
        messages.append(PoseEstimate(truth.stamp_ns, *pose, COVARIANCE, lost=k == 3))
    stamp = messages[-1].stamp_ns
    cells = np.arange(-1, 101, dtype=np.int8).reshape(6, 17)
    sums, sigmas = (0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3)
    unset = float("nan")
    return [
        *messages,
        RawBytes(stamp, "p3dx", "tx", b"\xfa\xfb\x03\x01\x00\x01"),
        RawBytes(stamp, "p3dx", "rx", b"\xfa\xfb\x03\x00\x00\x00"),
        RawBytes(stamp, "laser", "tx", b"VV\n"),
        RawBytes(stamp, "laser", "rx", bytes(range(256))),
        KeyframeDecision(stamp, 1, 20, "distance", "x", 0.5, 0.1, 0.5, 0.7, sums, sigmas),
        KeyframeDecision(
            stamp, 2, 25, "turn", "y", 0.5, 0.1, 0.5, unset, (), (), (0.02, 0.1, 0.03)
        ),
        FactorRecord(stamp, "prior", 0, 0, 0.0, 0.0, 0.0, COVARIANCE),
        FactorRecord(stamp, "loop", 0, 1, 0.5, -0.1, 0.1, COVARIANCE, False, "Prüfung: χ² zu groß"),
        LoopResult(stamp, 0, 1, False, "second place", 0.8, 0.75, float("nan")),
        OccupancyMap(stamp, 0.05, -1.0, -2.0, cells),
        LogLine(stamp, "warning", "laser", "lost: no scan for 1.0 s \N{EM DASH} Gerät aus?"),
        DeviceHealth(stamp, "laser", "lost", ("scans", "drift_ppm"), ("17", "-3.5")),
    ]


def main(path: Path) -> None:
    """Write the file and its digest."""
    messages = golden_messages()
    with LogWriter(path, {"id": "golden", "robot": "simulated"}) as log:
        log.add_metadata("laser", {"model": "URG-04LX", "serial": "H0000001"})
        log.add_attachment("config.toml", b"[matcher]\nkind = 'icp'\n", "application/toml")
        for message in messages:
            log.write(message, message.stamp_ns + 3_000_000)
    path.with_suffix(".sha256").write_text(digest(messages) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
