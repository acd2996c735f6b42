"""Runs of equal settings are taken together, with Student's interval."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from slam.evaluation.report.compare import (
    Group,
    Interval,
    bars,
    group_runs,
    groups_json,
    mean_interval,
)
from slam.evaluation.report.page_data import MOST_POINTS, column, shown_rows


def run(name: str, **keyframes):
    config = {"keyframes": keyframes, "map": {"resolution": 0.05}} if keyframes else {}
    return SimpleNamespace(name=name, records=SimpleNamespace(config=config))


def test_groups_are_named_after_what_tells_them_apart():
    runs = [
        run("a", method="constant", interval=1), run("b", method="sdp-pe", interval=1),
        run("c", method="constant", interval=1), run("d", method="sdp-pe", interval=1),
        run("e"),
    ]  # fmt: skip
    figures = [{"final_pose_error_m": v} for v in (1.0, 0.1, 3.0, 0.3, None)]
    groups = group_runs(runs, figures)
    assert [(g.label, g.members) for g in groups] == [
        ("method constant", (0, 2)), ("method sdp-pe", (1, 3)), ("e", (4,)),
    ]  # fmt: skip
    assert groups[0].values["final_pose_error_m"].mean == 2.0
    assert groups[2].values == {}
    document = groups_json(groups, runs)
    assert document[0]["runs"] == ["a", "c"]
    assert document[0]["means"]["final_pose_error_m"]["n"] == 2


def test_seeds_of_one_method_are_one_group():
    runs = [run(name, method="sdp-pe") for name in "abc"]
    (group,) = group_runs(runs, [{"ate_rmse_m": v} for v in (0.1, 0.2, 0.3)])
    assert group.label == "all runs"


def test_the_interval_holds_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(2000):
        found = mean_interval(norm.rvs(5.0, 2.0, size=6, random_state=rng))
        held += abs(found.mean - 5.0) < found.half
    assert held / 2000 == pytest.approx(0.95, abs=0.015)
    assert math.isnan(mean_interval([1.0]).half)


def test_bars_show_every_name_and_whiskers_only_where_known():
    def group(label, mean, half, n):
        return Group(label, (0,), {"final_pose_error_m": Interval(n, mean, half)})

    groups = [
        group("constant 1", 1.0, 0.5, 3),
        group("<b>", 2.0, math.nan, 1),
        Group("c", (0,), {}),
    ]
    (chart,) = bars(groups)
    assert (chart["title"], chart["unit"]) == ("Final pose error", "m")
    known, alone = chart["rows"]
    assert [known["label"], alone["label"]] == ["constant 1", "<b>"]
    assert (known["width"], known["low"], known["high"]) == (50.0, 25.0, 75.0)
    assert (alone["width"], alone["low"]) == (100.0, None)
    assert bars([Group("c", (0,), {})]) == []


def test_a_column_comes_back_as_it_was_rounded():
    values = np.array([1.23456, math.nan, -3.0, -2.99949, math.inf])
    assert column(values, 3) == {"scale": 1000, "steps": [1235, None, -4235, 1, None]}
    assert column(np.array([1e300, -1e300, 1.0]), 0)["steps"] == [None, None, 1]
    assert column(np.array([math.nan]), 2) == {"scale": 100, "steps": [None]}


def test_a_long_path_is_thinned_but_keeps_what_must_not_miss():
    rows = shown_rows(3 * MOST_POINTS, np.array([7]))
    assert len(rows) == MOST_POINTS + 1
    assert {0, 7, 3 * MOST_POINTS - 1} <= set(rows.tolist())
    assert shown_rows(5, np.array([4])).tolist() == [0, 1, 2, 3, 4]
