"""What the campaign calls a revisit, a false closure and a recall."""

from types import SimpleNamespace

import numpy as np
import pytest
from slam.logs.messages import FactorRecord

from benchmarks.buildings import judged_closures, revisits, summary_rows

# A square of 10 m sides, driven one and a half times, a keyframe a metre.
SIDE = [(1.0, 0.0, 0.0), (0.0, 1.0, np.pi / 2), (-1.0, 0.0, np.pi), (0.0, -1.0, -np.pi / 2)]


@pytest.fixture
def square():
    x = y = 0.0
    poses = []
    for k in range(60):
        dx, dy, theta = SIDE[k // 10 % 4]
        poses.append((x, y, theta))
        x, y = x + dx, y + dy
    return np.array(poses), np.arange(60.0)


def closure(i, j, x, y, theta, used=True, note=""):
    return FactorRecord(0, "loop", i, j, x, y, theta, tuple(np.eye(3).ravel()), used, note)


def test_a_second_lap_revisits_and_the_first_does_not(square):
    assert revisits(*square) == list(range(40, 60))


def test_the_way_back_is_no_revisit_for_a_laser_that_looks_ahead(square):
    there, path = square[0][:10], np.arange(20.0)
    back = np.add(there[::-1], (0.0, 0.0, np.pi))
    assert revisits(np.vstack([there, back]), path) == []


def test_closures_are_judged_by_the_truth(square):
    true, path = square
    factors = [
        closure(2, 42, 0.02, 0.0, 0.01),
        closure(4, 44, 0.4, 0.0, 0.0),
        closure(5, 45, 0.0, 0.0, 0.2),
        closure(9, 49, 9.0, 0.0, 0.0, used=False, note="removed: it lied"),
        FactorRecord(0, "icp", 1, 2, 9.0, 0.0, 0.0, tuple(np.eye(3).ravel())),
    ]
    keyframes = [SimpleNamespace(travelled_m=float(p)) for p in path]
    records = SimpleNamespace(factors=factors)
    result = SimpleNamespace(slam=SimpleNamespace(records=records, keyframes=keyframes))
    judged = judged_closures(result, true)
    assert judged["closures"] == 3
    assert judged["false_closures"] == 2
    assert judged["withdrawn"] == 1
    assert judged["revisits"] == 20
    assert judged["revisits_closed"] == 8  # 40 to 47: within 2 m of 42, 44 or 45


def test_rows_compare_with_the_drive_without_the_fault():
    one = {
        "building": "clutter", "seed": 1, "fault": "none", "ate_m": 0.01, "keyframes": 100,
        "closures": 10, "false_closures": 0, "revisits": 4, "revisits_closed": 3, "named": {},
    }  # fmt: skip
    named = {"stall": 1, "jump": 2}
    other = one | {"fault": "stall", "ate_m": 0.015, "named": named, "false_closures": 1}
    clean, faulty = summary_rows([one, other])
    assert (clean["fault"], clean["precision"], clean["recall"]) == ("none", 1.0, 0.75)
    assert clean["runs_named"] == ""
    assert faulty["ate_ratio_median"] == pytest.approx(1.5)
    assert faulty["precision"] == pytest.approx(0.9)
    assert faulty["runs_named"] == "1/1"
    assert faulty["other_named"] == 2
