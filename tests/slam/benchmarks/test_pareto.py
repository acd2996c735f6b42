"""The interval benchmark: its drives, its yardstick and its figure."""

import numpy as np
import pytest
from slam.drivers.simulators.drive import EPOCH_NS

from benchmarks.keyframe_interval import pareto
from benchmarks.keyframe_interval.counter import ALL, as_many, counter_test
from benchmarks.keyframe_interval.drives import Outcome, messages_of, outcome_of, settings
from benchmarks.keyframe_interval.figures import STYLES, draw_pareto
from benchmarks.keyframe_interval.judge import judged, on_other_seeds
from benchmarks.keyframe_interval.pareto import Job, drive, row

SETTINGS = settings()


def outcomes(setting, error):
    """Five drives with errors about `error` (m), and fewer matches the longer the interval."""
    matches = {"constant": round(30 / setting.keyframes.interval), "information": 40}
    count = matches.get(setting.method, 100)
    return [Outcome(count, count + 1, error + 0.001 * k, error, 10.0) for k in range(-2, 3)]


def made_up():
    """A world whose best constant interval is 0.6 m, and where information is a little better."""
    errors = {s: 0.10 + abs(np.log(s.keyframes.interval / 0.6)) for s in SETTINGS}
    errors |= {s: 0.095 for s in SETTINGS if s.method == "information"}
    return {s: outcomes(s, errors[s]) for s in SETTINGS}


def test_the_yardstick_is_the_best_constant_interval_of_the_world():
    verdict = next(v for v in judged("here", made_up()) if v["method"] == "information")
    assert verdict["best_constant"] == "0.6 m"
    assert verdict["error_ratio"] == pytest.approx(0.95, rel=1e-3)
    assert verdict["longest_tied_constant"] == "0.6 m"
    assert verdict["matches_ratio"] == pytest.approx(0.8)
    low, high = verdict["error_ratio_ci95"]
    assert low <= verdict["error_ratio"] <= high < 1.05


def test_a_constant_that_is_not_known_to_be_worse_is_tied_and_the_longest_counts():
    outcomes = made_up()
    longer = next(s for s in SETTINGS if s.label == "1.1 m")
    errors = [0.105, 0.097, 0.103, 0.099, 0.101]  # a little worse on average, better for some seeds
    outcomes[longer] = [Outcome(27, 28, error, error, 10.0) for error in errors]
    verdict = next(v for v in judged("here", outcomes) if v["method"] == "information")
    assert verdict["best_constant"] == "0.6 m"
    assert verdict["longest_tied_constant"] == "1.1 m"
    assert verdict["longest_tied_matches_ratio"] == pytest.approx(40 / 27)


def test_luck_in_the_choice_of_the_best_does_not_count():
    """Among forty equally good constants the luckiest looks better than it is."""
    constant = np.random.default_rng(5).normal(0.0, 0.5, (40, 30))
    own = np.linspace(-1.0, 1.0, 30)  # as good as they are: zero on average
    assert np.exp(np.mean(own) - np.min(np.mean(constant, axis=1))) > 1.15
    assert on_other_seeds(own, constant) == pytest.approx(1.0, abs=0.1)


def test_a_blind_choice_with_as_many_matches_lies_between_two_constants():
    counts, errors = np.array([100.0, 50.0, 25.0]), np.log([[0.4], [0.1], [0.2]])
    assert np.exp(as_many(50.0, counts, errors)) == pytest.approx(0.1)
    assert np.exp(as_many(np.sqrt(50.0 * 25.0), counts, errors)) == pytest.approx(np.sqrt(0.02))
    for beyond, nearest in ((1000.0, 0.4), (2.0, 0.2)):
        assert np.exp(as_many(beyond, counts, errors)) == pytest.approx(nearest)


def test_the_counter_test_tells_a_gain_that_normals_bring_from_one_that_they_do_not():
    """Here a choice with permuted normals is as good as a blind one, there as the true one."""
    here, there = made_up(), made_up()
    for world, error in ((here, 0.2), (there, 0.1)):
        for s in SETTINGS:
            if s.method == "constant":
                world[s] = outcomes(s, 0.2)
            elif s.method == "information":
                world[s] = outcomes(s, 0.1)
            elif s.method == "information-permuted":
                world[s] = outcomes(s, error)
    rows = {row["world"]: row for row in counter_test({"here": here, "there": there})}
    assert rows["here"]["blind_to_information"] == pytest.approx(2.0, rel=1e-3)
    assert rows["here"]["blind_to_permuted"] == pytest.approx(1.0, rel=1e-3)
    assert rows["here"]["permuted_to_information"] == pytest.approx(2.0, rel=1e-3)
    assert rows["there"]["permuted_to_information"] == pytest.approx(1.0, rel=1e-3)
    assert rows[ALL]["permuted_to_information"] == pytest.approx(np.sqrt(2.0), rel=1e-3)


def test_drives_that_are_done_are_kept_unless_made_with_other_settings(tmp_path, monkeypatch):
    made = []

    def count(world, seed, compared):
        made.append((world, seed))
        return [Outcome(1, 2, 0.1, 0.1, 1.0) for _ in compared]

    monkeypatch.setattr(pareto, "outcomes_of", count)
    monkeypatch.setattr(pareto, "warm_up", lambda: None)
    job = Job("testbed", 7, tmp_path)
    assert drive(job) == drive(job)
    assert made == [("testbed", 7)]
    monkeypatch.setattr(pareto, "settings", lambda: SETTINGS[:3])
    assert len(drive(job)) == 3
    assert len(made) == 2


def test_rows_hold_what_they_promise_and_the_figure_shows_every_method(tmp_path):
    rows = [row("here", setting, found) for setting, found in made_up().items()]
    promised = {"world", "method", "setting", "matches_median", "ate_m_median", "ate_m_ci95"}
    assert all(promised | {"cpu_ms_median"} <= set(r) for r in rows)
    assert {r["method"] for r in rows} == set(STYLES)
    draw_pareto(rows, tmp_path / "pareto.png")
    assert (tmp_path / "pareto.png").read_bytes().startswith(b"\x89PNG")


def test_a_drive_is_the_same_for_every_setting_and_each_time():
    begun = [m for m in messages_of("testbed", 3) if m.stamp_ns < EPOCH_NS + 8_000_000_000]
    chosen = [s for s in SETTINGS if s.method in ("information", "information-permuted")]
    for setting in chosen:
        first, again = (outcome_of(begun, setting) for _ in range(2))
        assert (first.matches, first.ate_m) == (again.matches, again.ate_m)
        assert 0.0 < first.ate_m < 0.05
