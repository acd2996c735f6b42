"""Runs of equal settings are taken together, with Student's interval."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from slam.evaluation.report.compare import group_runs, groups_json, mean_interval
from slam.evaluation.report.rows import bar_chart, strip_chart


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
    names = ["constant 1", "<b>", "a name that is far too long for its place"]
    drawing = bar_chart(
        names, np.array([1.0, 2.0, np.nan]), np.array([0.5, np.nan, np.nan]), "error [m]"
    )
    assert drawing.count('class="bars"') == 2
    assert drawing.count('class="whisker"') == 1
    assert "&lt;b&gt;" in drawing
    assert bar_chart(names, np.full(3, np.nan), np.full(3, np.nan), "x") == ""
    assert strip_chart([], 10.0, "x") == ""
    assert strip_chart([("turn", np.array([0.0, 5.0, 5.0]))], 10.0, "x").count("v14.4") == 2
