"""What a page is told: everything once, then only what has changed."""

import base64
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from slam.logs.messages import LaserScan, LoopResult

from slam.runs.status import Status
from slam.viewer.frames import BATCH, MOST_BEAMS, Feed
from slam.viewer.snapshot import View


def told(feed: Feed, snapshot, stage="tracking", status=None) -> list[dict]:
    return [json.loads(text) for text in feed.frames(View(stage, snapshot, status))]


def kinds(frames: list[dict]) -> list[str]:
    return [frame["type"] for frame in frames]


def unpack(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def test_a_new_page_gets_the_whole_run_and_then_only_the_state(snapshot):
    feed = Feed()
    first = told(feed, snapshot)
    batches = -(-len(snapshot.keyframes) // BATCH)
    assert kinds(first) == ["hello", *["keyframes"] * batches, "state"]
    poses = np.concatenate([unpack(f["poses"], "<f4") for f in first if "poses" in f])
    np.testing.assert_allclose(poses.reshape(-1, 3), snapshot.poses, atol=1e-5)
    assert first[-1]["keyframes"] == sum(len(f.get("items", ())) for f in first)
    assert first[-1]["pose"] == pytest.approx(snapshot.pose)
    assert len(first[-1]["covariance"]) == 9
    assert first[-1]["decision"]["t_pe"] > 0
    assert kinds(told(feed, snapshot)) == ["state"]


def test_before_the_first_keyframe_there_is_a_state_all_the_same():
    frames = told(Feed(), None, "waiting for data")
    assert kinds(frames) == ["hello", "state"]
    assert frames[1] == {"type": "state", "stage": "waiting for data"}


def test_keyframes_that_moved_are_told_and_creeping_ones_too_in_the_end(snapshot):
    feed = Feed()
    told(feed, snapshot)
    poses = snapshot.poses.copy()
    poses[3] += (0.0, 0.1, 0.0)
    (moved, _) = told(feed, replace(snapshot, poses=poses))
    assert moved["type"] == "moved"
    assert unpack(moved["rows"], "<u4").tolist() == [3]
    np.testing.assert_allclose(unpack(moved["poses"], "<f4"), poses[3], atol=1e-5)
    steps = []
    for _ in range(5):
        poses = poses + np.array([0.0009, 0.0, 0.0])
        steps.append(kinds(told(feed, replace(snapshot, poses=poses)))[0])
    assert steps == ["state", "state", "moved", "state", "state"]


def test_closures_are_told_once_and_all_again_when_some_are_withdrawn(snapshot):
    feed = Feed()
    a, b = (LoopResult(1, 0, k, True, "accepted", 0.9, 0.1, 1.0) for k in (5, 6))
    frames = told(feed, replace(snapshot, closure_results=(a,)))
    assert next(f for f in frames if f["type"] == "closures")["items"] == [[0, 5, True, "accepted"]]
    (closures, _) = told(feed, replace(snapshot, closure_results=(a, b)))
    assert (closures["first"], closures["items"]) == (1, [[0, 6, True, "accepted"]])
    withdrawn = replace(a, accepted=False, reason="withdrawn")
    (closures, _) = told(feed, replace(snapshot, closure_results=(withdrawn, b)))
    assert (closures["first"], len(closures["items"])) == (0, 2)
    assert kinds(told(feed, replace(snapshot, closure_results=(withdrawn, b)))) == ["state"]


def test_ranges_are_centimetres_and_what_is_no_wall_is_marked(snapshot):
    ranges = np.array([1.004, math.inf, math.nan, 0.05, 31.0, 29.996], dtype=np.float32)
    scan = LaserScan(0, -1.0, 0.5, ranges, 0.1, 30.0)
    state = told(Feed(), replace(snapshot, scan=scan))[-1]["scan"]
    assert unpack(state["cm"], "<u2").tolist() == [100, 65535, 65535, 65535, 65535, 3000]
    assert (state["start"], state["step"]) == (-1.0, 0.5)


def test_far_readings_and_many_beams_fit(snapshot):
    scan = LaserScan(0, -2.0, 0.004, np.full(1081, 900.0, dtype=np.float32))
    state = told(Feed(), replace(snapshot, scan=scan))[-1]["scan"]
    packed = unpack(state["cm"], "<u2")
    assert len(packed) <= MOST_BEAMS
    assert set(packed.tolist()) == {65534}
    assert state["step"] == pytest.approx(0.004 * 3)


def test_numbers_that_are_none_are_null(snapshot):
    decision = replace(snapshot.decisions[-1], t_pe=math.nan)
    odd = replace(snapshot, decisions=(*snapshot.decisions[:-1], decision), covariance=())
    state = told(Feed(), odd)[-1]
    assert state["decision"]["t_pe"] is None
    assert state["covariance"] == []


def test_devices_and_losses_come_from_the_robot_where_there_is_one(snapshot):
    status = Status(
        3.0, {"laser": "lost", "p3dx": "connected"}, 39.5, 0.02, 0, 7, math.nan, (),
        {"laser: outages": 1}, ("laser lost: no reply",),
    )  # fmt: skip
    state = told(Feed(), snapshot, status=status)[-1]
    assert state["devices"] == {"laser": "lost", "p3dx": "connected"}
    assert state["losses"] == {"laser: outages": 1}
    assert state["status"]["news"] == ["laser lost: no reply"]
