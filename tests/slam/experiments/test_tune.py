"""The search of `slam tune`: its space, its objectives, the same trials after interruptions."""

import math

import pytest

from slam.experiments.tune.objective import Objective, Score, score, value
from slam.experiments.tune.space import (
    Parameter,
    parse_parameter,
    parse_parameters,
    values_of,
    with_values,
)
from slam.experiments.tune.study import Search, best, open_study, search
from slam.mapping.config import SlamConfig
from slam.runs.errors import ConfigError, RunError

BASE = SlamConfig()
PARAMETERS = (
    Parameter("keyframes.interval", 0.1, 2.0, True),
    Parameter("loops.places", 1, 9, False),
)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("keyframes.t_high=0.5:6", Parameter("keyframes.t_high", 0.5, 6.0, False)),
        ("keyframes.weights.3=0.01:10:log", Parameter("keyframes.weights.3", 0.01, 10.0, True)),
        ("loops.places=2:8", Parameter("loops.places", 2, 8, False)),
        (
            "odometry.lost_inflation=1:100:log",
            Parameter("odometry.lost_inflation", 1.0, 100.0, True),
        ),
    ],
)
def test_a_parameter_is_a_setting_with_bounds(text, wanted):
    assert parse_parameter(text, BASE) == wanted


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("keyframes.t_hihg=1:2", "did you mean keyframes.t_high"),
        ("keyframes.weights.5=1:2", "unknown setting"),
        ("keyframes.weights.0=1:2", "unknown setting"),
        ("keyframes.weights=1:2", "not a number"),
        ("keyframes.method=1:2", "not a number"),
        ("loops.enabled=0:1", "not a number"),
        ("loops.places=1.5:3", "whole numbers"),
        ("keyframes.t_high", "expected section.key=low:high"),
        ("keyframes.t_high=3:1", "expected section.key=low:high"),
        ("keyframes.t_high=1:inf", "expected section.key=low:high"),
        ("keyframes.t_high=1:2:lgo", "expected section.key=low:high"),
        ("keyframes.t_low=0:2:log", "above 0"),
    ],
)
def test_a_malformed_parameter_is_refused_by_name(text, wrong):
    with pytest.raises(ConfigError, match=wrong):
        parse_parameter(text, BASE)


def test_a_parameter_is_given_once_and_there_is_one():
    with pytest.raises(ConfigError, match="nothing to tune"):
        parse_parameters([], BASE)
    with pytest.raises(ConfigError, match="more than once"):
        parse_parameters(["loops.places=1:2", "loops.places=1:3"], BASE)


def test_values_go_to_their_places_and_nothing_else_changes():
    changed = with_values(BASE, {"keyframes.weights.2": 0.7, "keyframes.weights.4": 0.1})
    before = BASE.keyframes.weights
    assert changed.keyframes.weights == (before[0], 0.7, before[2], 0.1)
    assert with_values(changed, {f"keyframes.weights.{k}": before[k - 1] for k in (2, 4)}) == BASE
    assert values_of(changed, [Parameter("keyframes.weights.2", 0.0, 1.0, False)]) == {
        "keyframes.weights.2": 0.7
    }


def test_values_that_do_not_go_together_are_refused():
    with pytest.raises(ConfigError, match="min_interval must not exceed"):
        with_values(BASE, {"keyframes.min_interval": 0.4, "keyframes.max_interval": 0.3})


def record(ate=None, relations=None, matches=10):
    figures = {"ate_rmse_m": ate, "relations": {"trans_mean_m": relations} if relations else None}
    return {"status": "ok", "figures": figures, "summary": {"matches": matches}}


def test_each_objective_reads_its_own_truth():
    assert score(record(ate=0.1), Objective.ate) == Score(0.1, 10)
    assert score(record(ate=0.1), Objective.relations).error_m == math.inf
    assert score(record(relations=0.2), Objective.relations) == Score(0.2, 10)
    assert score(record(relations=0.2), Objective.matches) == Score(0.2, 10)
    assert score({"status": "failed", "reason": "x"}, Objective.ate).error_m == math.inf


def test_error_counts_by_ratios_and_a_failed_log_spoils_the_trial():
    easy_halved = [Score(0.005, 1), Score(1.0, 1)]
    hard_halved = [Score(0.01, 1), Score(0.5, 1)]
    both = [value(Objective.ate, scores, []) for scores in (easy_halved, hard_halved)]
    assert both[0] == pytest.approx(both[1])
    assert value(Objective.ate, [Score(0.01, 1), Score(math.inf, math.inf)], []) == math.inf


def test_fewer_matches_win_only_at_equal_error():
    reference = [Score(0.10, 100)]
    less, much_less = Score(0.10, 50), Score(0.101, 10)
    far_off = Score(0.5, 5)
    ours = (less, reference[0], much_less, far_off)
    found = [value(Objective.matches, [s], reference) for s in ours]
    assert found[0] == pytest.approx(0.5)
    assert found == sorted(found)


def bowl(proposed):
    """Smallest at interval 0.5 with 4 places; settings beyond 1.5 do not work."""
    return [
        math.inf
        if v["keyframes.interval"] > 1.5
        else abs(math.log(v["keyframes.interval"] / 0.5)) + abs(v["loops.places"] - 4)
        for v in proposed
    ]


def run(path, judge=bowl, trials=24, seed=3):
    study = open_study(f"sqlite:///{path}", {"objective": "ate", "bounds": [1, 2]})
    search(study, Search(PARAMETERS, trials, 4, seed), values_of(BASE, PARAMETERS), judge)
    return study


def trials(study):
    return [(t.params, t.value) for t in study.get_trials()]


def test_the_search_begins_with_what_there_is_and_finds_the_best(tmp_path):
    study = run(tmp_path / "study.db")
    assert trials(study)[0][0] == values_of(BASE, PARAMETERS)
    assert len(trials(study)) == 24
    found = best(study)
    assert found.params["loops.places"] == 4
    assert best(study).value < bowl([values_of(BASE, PARAMETERS)])[0]


def test_an_interrupted_search_tries_the_same_as_one_in_a_piece(tmp_path):
    calls = []

    def breaks_twice(proposed):
        calls.append(len(proposed))
        if len(calls) in (2, 4):
            raise KeyboardInterrupt
        return bowl(proposed)

    whole = trials(run(tmp_path / "whole.db", trials=14))
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "parts.db", breaks_twice, trials=14)
    assert trials(run(tmp_path / "parts.db", breaks_twice, trials=14)) == whole
    assert sum(calls) == 14 + 2 * 4  # rounds that were cut short
    assert trials(run(tmp_path / "parts.db", trials=16))[:14] == whole
    assert trials(run(tmp_path / "other.db", trials=4, seed=4)) != whole[:4]


def test_a_study_of_another_question_is_not_continued(tmp_path):
    run(tmp_path / "study.db", trials=1)
    with pytest.raises(RunError, match="study of other bounds"):
        open_study(f"sqlite:///{tmp_path / 'study.db'}", {"objective": "ate", "bounds": [1, 3]})


def test_bad_databases_and_hopeless_searches_say_so(tmp_path):
    with pytest.raises(RunError, match="cannot be used for the study"):
        open_study(f"sqlite:///{tmp_path / 'no' / 'folder.db'}", {})
    with pytest.raises(RunError, match="no trial worked"):
        best(run(tmp_path / "study.db", lambda proposed: [math.inf] * len(proposed), trials=4))
