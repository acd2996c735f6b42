"""What goes to one page: all of a run at first, later only what has changed.

Frames are JSON objects with a `type`; arrays of numbers travel as base64 of little-endian
values, because a browser makes a typed array of them without reading digits.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.logs.messages import KeyframeDecision, LaserScan, LoopResult
from slam.mapping.keyframe import Keyframe
from slam.runs.status import Status
from slam.viewer.snapshot import DRIVING, Snapshot, View

MOST_BEAMS = 361  # of a scan on the page
BATCH = 100  # keyframes in one frame, so that a long run does not come in one lump
_STILL_M = 2e-3  # a keyframe that moved by less stays where it is on the page
_STILL_RAD = 5e-4
_NO_RETURN = 65535


class Feed:
    """What one page has been sent so far."""

    def __init__(self) -> None:
        self._poses = np.zeros((0, 3), dtype=np.float32)
        self._closures: tuple[LoopResult, ...] = ()
        self._pruned_count = 0
        self._greeted = False

    def frames(self, view: View) -> Iterator[str]:
        """Yield what brings the page up to date."""
        snapshot = view.snapshot
        if snapshot is not None and snapshot.pruned_counts != self._pruned_count:
            self._poses, self._closures = self._poses[:0], ()
            self._pruned_count, self._greeted = snapshot.pruned_counts, False
        if not self._greeted:
            self._greeted = True
            yield _json({"type": "hello"})
        if snapshot is not None:
            yield from self._new_keyframes(snapshot)
            yield from self._moved(snapshot)
            yield from self._new_closures(snapshot)
        yield _json({"type": "state", "stage": view.stage} | _state(snapshot) | _devices(view))

    def _new_keyframes(self, snapshot: Snapshot) -> Iterator[str]:
        total = len(snapshot.keyframes)
        poses = snapshot.poses.astype("<f4")
        for first in range(len(self._poses), total, BATCH):
            rows = slice(first, min(first + BATCH, total))
            yield _json(
                {
                    "type": "keyframes",
                    "first": first,
                    "mount": [
                        snapshot.extrinsics.x,
                        snapshot.extrinsics.y,
                        snapshot.extrinsics.theta,
                    ],
                    "poses": _base64(poses[rows]),
                    "items": [
                        _keyframe(keyframe, decision)
                        for keyframe, decision in zip(
                            snapshot.keyframes[rows], snapshot.decisions[rows], strict=True
                        )
                    ],
                }
            )
            self._poses = np.concatenate([self._poses, poses[rows]])

    def _moved(self, snapshot: Snapshot) -> Iterator[str]:
        poses = snapshot.poses.astype("<f4")
        step = np.abs(poses - self._poses)
        rows = np.flatnonzero((step > [_STILL_M, _STILL_M, _STILL_RAD]).any(axis=1))
        if len(rows):
            self._poses[rows] = poses[rows]
            yield _json(
                {
                    "type": "moved",
                    "rows": _base64(rows.astype("<u4")),
                    "poses": _base64(poses[rows]),
                }
            )

    def _new_closures(self, snapshot: Snapshot) -> Iterator[str]:
        known, now = self._closures, snapshot.closure_results
        same = len(known) <= len(now) and all(a is b for a, b in zip(known, now, strict=False))
        first = len(known) if same else 0  # the end of a run may withdraw some
        self._closures = now
        if first < len(now) or not same:
            yield _json(
                {
                    "type": "closures",
                    "first": first,
                    "items": [[v.i, v.j, v.accepted, v.reason] for v in now[first:]],
                }
            )


def _state(snapshot: Snapshot | None) -> dict[str, Any]:
    if snapshot is None:
        return {}
    last, decision = snapshot.keyframes[-1], snapshot.decisions[-1]
    return {
        "pose": snapshot.pose,
        "covariance": [_number(v) for v in snapshot.covariance],
        "astray": snapshot.lost,
        "scan": _scan(snapshot.scan) if snapshot.scan else None,
        "scans": snapshot.scans,
        "keyframes": len(snapshot.keyframes),
        "matches": snapshot.matches,
        "travelled_m": last.travelled_m,
        "seconds": (
            (snapshot.scan.stamp_ns - snapshot.keyframes[0].scan.stamp_ns) * 1e-9
            if snapshot.scan
            else 0.0
        ),
        "decision": {
            "t_pe": _number(decision.t_pe),
            "interval": _number(decision.interval_m),
            "unit": snapshot.interval_unit,
            "reason": decision.reason,
            "axis": decision.axis,
            "sigmas": [_number(v) for v in decision.achieved_sigmas],
        },
        "losses": snapshot.losses,
    }


def _devices(view: View) -> dict[str, Any]:
    status = view.status
    if status is None:
        return {}
    return {
        "devices": dict(status.links),
        "losses": dict(status.lost),
        "status": _status(status),
        "alarm": status.alarm if view.stage in DRIVING else "",
    }


def _status(status: Status) -> dict[str, Any]:
    return {
        "seconds": status.seconds,
        "scan_hz": _number(status.scan_hz),
        "age_s": _number(status.age_s),
        "waiting": status.waiting,
        "news": status.news,
        "reasons": dict(status.reasons),
        "robot": dict(status.robot),
        "warnings": status.warnings,
    }


def _keyframe(keyframe: Keyframe, decision: KeyframeDecision) -> dict[str, Any]:
    return {
        "scan": _scan(keyframe.scan),
        "at_m": keyframe.travelled_m,
        "t_pe": _number(decision.t_pe),
        "interval": _number(decision.interval_m),
    }


def _scan(scan: LaserScan) -> dict[str, Any]:
    """Ranges in cm as far as 16 bits go; thinned evenly where there are many beams."""
    step = max(1, -(-len(scan.ranges) // MOST_BEAMS))
    ranges = scan.ranges[::step]
    seen = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    centimetres = np.where(seen, np.minimum(np.nan_to_num(ranges, posinf=0.0) * 100, 65534), 0)
    packed = np.where(seen, np.round(centimetres), _NO_RETURN).astype("<u2")
    return {"start": scan.angle_min, "step": scan.angle_step * step, "cm": _base64(packed)}


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _json(value: dict[str, Any] | Sequence[Any]) -> str:
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
