"""The paper's experiment: its counts, its controls, and what its figures are made of."""

from itertools import pairwise

import numpy as np
import pytest
from slam.frontend.keyframes import SHORTEST_M, KeyframeConfig
from slam.frontend.match_types import TOLERANCE_M, MatchConfig
from slam.frontend.scan import VALID

from benchmarks.paper import closest
from benchmarks.paper.drives import (
    CONSTANT,
    PAPER_COUNTS,
    Outcome,
    chosen,
    evenly,
    every,
    follow,
    information,
    matched,
    paper_bed_drive,
    sdp_pe,
)
from benchmarks.paper.figures import draw_comparison
from benchmarks.paper.icp import drop_longest, one_to_one_pairs
from benchmarks.paper.paper import FIRST_TRAINING_SEED, SEEDS, Setting, compared, row
from benchmarks.paper.report import write_paper_report
from benchmarks.paper.spread import median_ci95
from benchmarks.paper.study import BEDS, RULES, Rules, by_rules


@pytest.fixture(scope="module")
def drive():
    return paper_bed_drive("180cm", FIRST_TRAINING_SEED)


def test_constant_intervals_use_as_many_scans_as_in_the_paper():
    assert tuple(len(every(k)) for k in CONSTANT) == PAPER_COUNTS[:-1]


def test_training_beds_are_not_among_those_reported_on():
    assert SEEDS >= 30
    assert FIRST_TRAINING_SEED >= SEEDS


def test_a_drive_has_462_scans_on_180_centimetres(drive):
    assert len(drive.scans) == len(drive.odometry) == len(drive.truth) == 462
    assert {len(scan.points) for scan in drive.scans} == {181}
    assert drive.truth[-1].x() == pytest.approx(1.80)
    assert drive.step_m * 461 == pytest.approx(1.80)


def test_sdp_pe_goes_all_the_way_and_its_control_takes_as_many_scans(drive):
    config = KeyframeConfig(method="sdp-pe")
    used = chosen(drive, sdp_pe())
    assert used[0] == 0
    assert used[-1] == 461
    steps = drive.step_m * np.diff(used)
    assert (steps[:-1] >= config.min_interval).all()
    assert (steps <= config.max_interval + drive.step_m).all()
    control = evenly(len(used))
    assert len(control) == len(used)
    assert (control[0], control[-1]) == (0, 461)
    assert np.ptp(np.diff(control)) <= 1


def test_shorter_intervals_use_more_scans(drive):
    counts = [len(chosen(drive, sdp_pe(stretch))) for stretch in (0.001, 0.1, 0.3, 1.0, 100.0)]
    assert counts[0] == 462
    assert counts[-1] == 2
    assert counts == sorted(counts, reverse=True)


@pytest.mark.parametrize("with_odometry", [False, True])
def test_information_goes_as_far_as_its_limits_allow(drive, with_odometry):
    config = KeyframeConfig()
    used = chosen(drive, information(drive, with_odometry))
    steps = drive.step_m * np.diff(used)
    assert (steps[:-1] >= SHORTEST_M).all()
    assert (steps <= config.longest + drive.step_m).all()


def test_true_steps_end_without_error(drive):
    outcome = follow(drive, every(20), lambda i, j: drive.truth[i].between(drive.truth[j]))
    assert outcome.error_m < 1e-12
    assert outcome.used[-1] == 460
    assert outcome.poses[-1, 0] == pytest.approx(460 * drive.step_m)


def test_point_to_point_loses_most_of_the_way_and_point_to_line_does_not(drive):
    """The paper's first figure, 107.6 of 180 cm, is what nearest points do at interval 1."""
    errors = {
        method: follow(drive, every(1), matched(drive, MatchConfig(method=method), False)).error_m
        for method in ("point_to_point", "point_to_line")
    }
    assert errors["point_to_point"] > 0.9
    assert errors["point_to_line"] < 0.2


def test_the_open_icp_is_the_matcher_where_both_have_the_same_rules(drive):
    """Two searches for the nearest point, one by bearing and one that tries all."""
    rules = Rules(iterations=50, tolerance=TOLERANCE_M)
    ours = matched(drive, MatchConfig(method="point_to_point"), False)
    theirs = by_rules(drive, rules)
    for i, j in pairwise(every(40)):
        assert theirs(i, j).equals(ours(i, j), 1e-9)


def test_one_to_one_leaves_each_target_to_the_closest():
    partner, square = np.array([4, 4, 2, 4, -1]), np.array([3.0, 1.0, 9.0, 2.0, 5.0])
    one_to_one_pairs(partner, square, 6)
    assert partner.tolist() == [-1, 4, 2, -1, -1]


def test_the_longest_pairs_are_dropped():
    partner, square = np.array([0, 1, 2, 3, -1]), np.array([3.0, 1.0, 9.0, 2.0, 0.5])
    drop_longest(partner, square, 0.5)
    assert partner.tolist() == [0, 1, -1, 3, -1]


@pytest.mark.parametrize("rules", RULES)
def test_all_rules_find_a_known_motion_in_a_closed_bed(rules):
    bed = BEDS["end wall 2.1 m past, boards of 10 to 30 cm, to 50 cm deep"]
    closed = paper_bed_drive("180cm", FIRST_TRAINING_SEED, bed)
    found = by_rules(closed, RULES[rules])(0, 30)
    assert np.hypot(found.x() - 30 * closed.step_m, found.y()) < 0.06
    assert all((scan.flags & VALID).sum() > 150 for scan in closed.scans[::100])


def outcome(error_m, scans=24):
    return Outcome(tuple(range(scans)), np.zeros((scans, 3)), error_m, 5.0)


def test_rows_have_the_keys_that_checks_rely_on():
    setting = Setting("180cm", "point_to_line", False, "20")
    found = row(setting, [outcome(e) for e in (0.01, 0.02, 0.09)])
    assert found["final_error_cm_median"] == pytest.approx(2.0)
    assert found["final_error_cm_ci95"] == [pytest.approx(1.0), pytest.approx(9.0)]
    assert found["scans_used_median"] == 24
    assert found["match_ms_median"] == 5.0
    assert found["seeds"] == 3


def test_the_interval_of_a_median_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(200):
        low, high = median_ci95(rng.standard_normal(30))
        hits += low <= 0.0 <= high
    assert 180 <= hits <= 199


def made_up(kind, errors, control):
    """Outcomes of every method, SDP-PE with these errors (m)."""
    case = ("180cm", "point_to_line", False)
    found = {
        Setting(*case, str(k)): [outcome(0.5 / k, len(every(k)))] * len(errors) for k in CONSTANT
    }
    for name, values in (
        (f"sdp-pe{kind}", errors), (f"even{kind}", control), ("information", errors)
    ):  # fmt: skip
        found[Setting(*case, name)] = [outcome(value, 23) for value in values]
    return found


def test_sdp_pe_is_compared_with_the_best_constant_and_with_its_control():
    (found,) = compared(made_up("", [0.020, 0.021, 0.022], [0.03, 0.03, 0.03]))
    assert found["falls"]
    assert found["best_constant"] == "20"
    assert found["best_constant_cm"] == pytest.approx(2.5)
    assert found["error_cm"] == pytest.approx(2.1)
    assert found["minus_even_cm_ci95"] == [pytest.approx(-1.0), pytest.approx(-0.8)]
    assert found["scans"] == 23
    assert found["best_constant_scans"] == 24


CLOSEST = [
    {
        "bed": bed,
        "matcher": matcher,
        "seeds": 3,
        "errors_cm": [7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0],
        "errors_cm_ci95": [[e - 1.0, e + 1.0] for e in (7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.5)],
        "sdp_pe_minus_even_cm_ci95": [0.5, 1.5],
        "sdp_pe_minus_20_cm_ci95": [-1.5, -0.5],
    }
    for bed in closest.BEDS
    for matcher in closest.MATCHERS
]


def test_figure_7_is_drawn_from_the_rows_of_the_closest_reading(tmp_path):
    closest.draw_closest(CLOSEST, tmp_path / "fig7.png")
    assert (tmp_path / "fig7.png").stat().st_size > 20_000


def test_in_the_bed_closed_ahead_point_to_point_falls_as_in_the_paper():
    drive = paper_bed_drive("180cm", 0, closest.BEDS[closest.CLOSED])
    step = closest.MATCHERS["point-to-point, one to one"](drive)
    errors_cm = [100.0 * follow(drive, every(k), step).error_m for k in (5, 10, 20)]
    assert 15.0 < errors_cm[0] < 40.0
    assert errors_cm[0] > 1.5 * errors_cm[1] > 2.0 * errors_cm[2]
    assert errors_cm[2] < 6.0


@pytest.mark.parametrize(
    ("errors", "word"),
    [([0.02] * 3, "in 1 of 1 cases. Looking at the walls helped in 1"), ([0.04] * 3, "in 0 of 1")],
)
def test_the_report_says_in_words_what_holds(tmp_path, errors, word):
    outcomes = made_up("", errors, [0.03] * 3) | made_up("-shipped", errors, [0.03] * 3)
    rows = [row(setting, of) for setting, of in outcomes.items()]
    rows += [{**one, "reading": "878cm"} for one in rows]
    both = compared(outcomes)
    both += [{**one, "reading": "878cm"} for one in both]
    meta = {"seeds": 3, "compared": both, "study": [], "closest": CLOSEST}
    write_paper_report(rows, meta, tmp_path / "paper.md")
    text = (tmp_path / "paper.md").read_text("utf-8")
    assert word in text
    assert ("**holds not**" in text) == (errors[0] > 0.025)
    assert "462 steps of 1.9 cm make 878 cm" in text
    assert "| closed 2.1 m past the end | point-to-line | 7.0 (6.0 to 8.0) |" in text
    draw_comparison([one for one in rows if one["reading"] == "180cm"], "180cm", tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 20_000
