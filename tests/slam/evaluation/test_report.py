"""Reports on runs made by hand: the numbers, the page, and what is said when parts are missing."""

import base64
import html.parser
import json
import math
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from slam.backend.se2 import between, compose
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import (
    FactorRecord,
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LoopResult,
    PoseEstimate,
    TruePose,
)
from slam.logs.trajectory import NS, Trajectory, path_length, write_tum

import slam.evaluation.report
from slam.evaluation.report.evaluate import evaluate
from slam.evaluation.report.html import SCRIPTS
from slam.evaluation.report.page import asset, format_number
from slam.evaluation.report.truth import find_clock_offset, read_truth
from slam.evaluation.report.write import write_report
from slam.maps.nav2_map import write_nav2_map
from slam.maps.occupancy import MapConfig, build_map
from slam.runs.errors import ReportError

START_NS = 1_700_000_000 * NS
SCHEMA = Path(slam.evaluation.report.__file__).with_name("report.schema.json")
HOSTILE = "<script>alert('x')</script>&"


CONFIG = {
    "keyframes": {"method": "sdp-pe", "unit": "metres"},
    "graph": {"match_sigma_trans": 0.008, "match_sigma_rot": 0.004},
}


def drive(n: int = 1200, seed: int = 1) -> Trajectory:
    """Two rounds of a rectangular corridor with some weaving, at 10 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 4 * math.pi / n
    x, y = (
        8 * np.tanh(2 * np.cos(t)),
        5 * np.tanh(2 * np.sin(t)) + 0.2 * np.sin(9.3 * t + rng.uniform()),
    )
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    return Trajectory(START_NS + np.arange(n) * (NS // 10), np.column_stack([x, y, heading]))


def drifted(truth: Trajectory, noise: float, seed: int = 2) -> Trajectory:
    """Integrate the true motion with noise, starting at the origin of an own frame."""
    rng = np.random.default_rng(seed)
    poses = [np.zeros(3)]
    for a, b in zip(truth.poses[:-1], truth.poses[1:], strict=True):
        c, s = math.cos(a[2]), math.sin(a[2])
        step = b - a
        step = np.array([c * step[0] + s * step[1], c * step[1] - s * step[0], step[2]])
        poses.append(compose(poses[-1], step + rng.normal(0, noise, 3) * [1, 1, 0.5]))
    return Trajectory(truth.stamps_ns, np.array(poses))


def square_scan(stamp_ns: int, pose: np.ndarray) -> LaserScan:
    angles = np.radians(np.arange(-180, 180, 3.0))
    dx, dy = np.cos(angles + pose[2]), np.sin(angles + pose[2])
    with np.errstate(divide="ignore"):
        reach = np.minimum(
            np.where(dx >= 0, 10.3 - pose[0], -10.3 - pose[0]) / dx,
            np.where(dy >= 0, 7.3 - pose[1], -7.3 - pose[1]) / dy,
        )
    return LaserScan(stamp_ns, angles[0], math.radians(3.0), reach.astype(np.float32))


def checked_json(path: Path) -> dict:
    """Read a report.json that is as its schema says."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(SCHEMA.read_text())
    document = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.Draft202012Validator(schema).validate(document)
    return document


def make_run(
    directory: Path, truth: Trajectory, truth_in_log: bool = True, seed: int = 2
) -> Trajectory:
    """Write a whole RUN directory and return its trajectory."""
    directory.mkdir()
    estimate, odometry = drifted(truth, 0.001, seed), drifted(truth, 0.01, seed + 1)
    write_tum(directory / "trajectory.tum", estimate)
    write_tum(directory / "odometry.tum", odometry)
    rows = np.arange(0, len(truth), 12)
    keyframes = estimate.select(rows)
    write_tum(directory / "keyframes.tum", keyframes)
    scans = [square_scan(int(truth.stamps_ns[k]), truth.poses[k]) for k in rows]
    grid = build_map(scans, keyframes.poses, MapConfig(resolution=0.1))
    write_nav2_map(directory, grid)
    summary = {
        "log": f"drive {HOSTILE}.mcap",
        "scans": len(truth),
        "keyframes": len(rows),
        "matches": len(rows) * 6,
        "loops": {"candidates": 2, "accepted": 1, "rejected": 1},
        "timing": {"wall_s": 2.5, "realtime_factor": 48.0, "match_us_median": math.nan},
        "lost": {"stamps reordered": 3},
        "version": "0.1.0",
        "config_sha256": "ab" * 32,
    }
    (directory / "summary.json").write_text(json.dumps(summary))
    with LogWriter(directory / "run.mcap") as log:
        log.add_attachment("config.json", json.dumps(CONFIG).encode(), "application/json")
        log.write(LaserExtrinsics(int(truth.stamps_ns[0]), 0.0, 0.0, 0.0))
        for scan in scans:
            log.write(scan)
        write_records(log, truth, estimate, rows, truth_in_log)
    return estimate


def write_records(log, truth, estimate, rows, truth_in_log) -> None:
    travelled = path_length(estimate.poses)
    stamps = truth.stamps_ns.tolist()
    for k, (stamp, true, pose) in enumerate(
        zip(stamps, truth.poses.tolist(), estimate.poses.tolist(), strict=True)
    ):
        if truth_in_log:
            log.write(TruePose(stamp, *true))
        variance = 1e-6 * (k + 1)
        covariance = tuple(np.diag([variance, variance, variance / 4]).ravel().tolist())
        log.write(PoseEstimate(stamp, *pose, covariance))
    for index, row in enumerate(rows.tolist()):
        step = float(travelled[row] - travelled[rows[max(index - 1, 0)]])
        reason = "first" if index == 0 else ("turn" if index % 5 == 0 else "distance")
        log.write(
            KeyframeDecision(
                stamps[row], index, row, reason, "x" if index % 3 else "theta", step, 0.1,
                step * 1.1, 2.0 + math.sin(index / 4), (1.0, 2.0, 3.0, 4.0), (0.01, 0.01, 0.002),
            )
        )  # fmt: skip
    i, j = 3, len(rows) - 2
    log.write(LoopResult(stamps[-9], i, j, True, "accepted", 0.91, 0.4, 2.5))
    log.write(LoopResult(stamps[-5], i + 1, j, False, HOSTILE, 0.5, 0.48, math.nan))
    for k in range(1, len(rows)):
        covariance = tuple((1e-4 * np.eye(3)).ravel().tolist())
        step = (0.5, 0.0, 0.0)
        log.write(FactorRecord(stamps[rows[k]], "icp", k - 1, k, *step, covariance))
        wheels = (0.53, 0.04, 0.0)
        used = k % 10 != 0
        log.write(FactorRecord(stamps[rows[k]], "odometry", k - 1, k, *wheels, covariance, used))
    loop = (0.05, 0.02, 0.0)
    log.write(FactorRecord(stamps[-9], "loop", i, j, *loop, tuple(np.eye(3).ravel().tolist())))


class Page(html.parser.HTMLParser):
    """Collects what a page refers to, what it runs and draws, and its text without scripts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.references: list[str] = []
        self.scripts: list[str] = []
        self.charts: list[tuple[int, int]] = []
        self.shown = ""
        self.data: dict = {}
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.references += [v for k, v in attrs if k in ("href", "src", "xlink:href")]
        values = dict(attrs)
        self._inside = values.get("type", tag) if tag in ("script", "style") else ""
        if self._inside == "script":
            self.scripts.append("")
        if "data-chart" in values:
            self.charts.append((int(values["data-run"]), int(values["data-chart"])))

    def handle_endtag(self, tag):
        self._inside = ""

    def handle_data(self, data):
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside == "application/octet-stream":
            self.data = json.loads(zlib.decompress(base64.b64decode(data)), parse_constant=fail)
        elif self._inside != "style":
            self.shown += data


def fail(constant: str):
    raise AssertionError(f"{constant} is not JSON")


def decoded(packed: dict) -> np.ndarray:
    """Values of a column of the page, as its scripts decode it."""
    found, total = [], 0
    for step in packed["steps"]:
        total += step or 0
        found.append(math.nan if step is None else total / packed["scale"])
    return np.array(found)


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    return drive()


@pytest.fixture(scope="module")
def run(tmp_path_factory, truth) -> Path:
    directory = tmp_path_factory.mktemp("report") / "run"
    make_run(directory, truth)
    return directory


def test_truth_in_the_log_is_used_by_itself(run):
    report = evaluate(run)
    figures = report.figures
    assert report.warnings == ()
    assert figures["truth"] == {"kind": "trajectory", "source": "/truth"}
    assert 0.0 < figures["ate_median_m"] <= figures["ate_rmse_m"] < 1.0
    assert figures["ate_rmse_m"] <= figures["ate_start_aligned_rmse_m"]
    assert figures["ate_unaligned_rmse_m"] > 5.0  # the map frame starts elsewhere
    assert figures["final_pose_error_m"] > 0.0
    assert figures["rpe"]["1m"]["trans_rmse_m"] < figures["rpe"]["10m"]["trans_rmse_m"]
    assert 0.0 < figures["anees"] < 100.0
    assert figures["relations"] is None
    assert figures["keyframes"] == 100
    assert figures["matches"] == 600
    assert figures["timing"]["wall_s"] == 2.5
    assert figures["consistency"]["closure_residual_median_m"] > 0.0
    assert figures["consistency"]["odometry_disagreement_per_m"] > 0.0
    assert figures["consistency"]["odometry_against_icp_median_m"] == pytest.approx(0.05)
    assert figures["consistency"]["odometry_refused_share"] == pytest.approx(9 / 99)
    assert figures["consistency"]["wall_thickness_median_m"] > 0.0


def test_a_perfect_run_has_no_error(tmp_path, truth):
    (tmp_path / "run").mkdir()
    write_tum(tmp_path / "run" / "trajectory.tum", truth)
    write_tum(tmp_path / "truth.tum", truth)
    figures = evaluate(tmp_path / "run", tmp_path / "truth.tum").figures
    assert figures["ate_rmse_m"] < 1e-12
    assert figures["ate_unaligned_rmse_m"] < 1e-12
    assert figures["final_pose_error_m"] < 1e-12


def test_relations_give_the_promised_keys(run, truth, tmp_path):
    a, b = truth.poses[100], truth.poses[400]
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[:2] - a[:2]
    stamps = [truth.stamps_ns[k] / NS for k in (100, 400)]
    line = (
        f"{stamps[0]:.6f} {stamps[1]:.6f} {c * dx + s * dy} {c * dy - s * dx} 0 0 0 {b[2] - a[2]}\n"
    )
    path = tmp_path / "x.relations"
    path.write_text(line * 4 + "5 6 0 0 0 0 0 0\n")
    report = evaluate(run, path)
    relations = report.figures["relations"]
    assert set(relations) == {
        *("n", "missing", "trans_mean_m", "trans_std_m", "trans_median_m", "trans_max_m"),
        *("rot_mean_deg", "rot_std_deg"),
    }
    assert (relations["n"], relations["missing"]) == (4, 1)
    assert relations["trans_mean_m"] < 0.5
    assert report.figures["ate_rmse_m"] is None
    assert any("1 of 5 relations" in warning for warning in report.warnings)


def test_the_paper_way_only_the_end_was_surveyed(run, tmp_path):
    estimate = evaluate(run).run.trajectory
    x, y, theta = estimate.poses[-1]
    path = tmp_path / "end.csv"
    path.write_text(
        f"t,x,y,theta\n{estimate.stamps_ns[-1] / NS + 1.0:.3f},{x + 0.03},{y - 0.04},{theta}\n"
    )
    figures = evaluate(run, path).figures
    assert figures["truth"]["kind"] == "survey"
    assert figures["final_pose_error_m"] == pytest.approx(0.05, abs=1e-6)
    assert figures["ate_rmse_m"] is None


def test_a_survey_of_several_poses_is_interpolated(run, truth, tmp_path):
    rows = [0, 300, 700, 1199]
    lines = [
        ",".join([f"{truth.stamps_ns[k] / NS + 0.01:.3f}", *map(repr, truth.poses[k].tolist())])
        for k in rows
    ]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n")
    figures = evaluate(run, path).figures
    assert figures["pairs"] == 4
    assert 0.0 < figures["ate_rmse_m"] < 0.5


def test_one_page_and_one_json(run, tmp_path, truth):
    make_run(tmp_path / "second", truth, seed=9)
    out = tmp_path / "report.html"
    reports = write_report([run, tmp_path / "second"], None, out)
    text = out.read_text()
    page = Page(text)
    assert all(reference.startswith("#") for reference in page.references)
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert not re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?(?:https?:)?//", own)
    assert page.scripts == [asset(name) for name in SCRIPTS]
    assert HOSTILE not in text
    assert text.count("&lt;script&gt;") >= 2
    assert len(page.charts) >= 2 * 8
    assert page.tags.count("nav") == 1
    assert "Means ± 95 % interval, by settings" in text
    assert "Errors pair by pair" not in text, "two drives have nothing to pair"
    assert "Final pose error" in text
    assert not re.search(r"\b(nan|inf|None|undefined)\b", page.shown)
    document = checked_json(tmp_path / "report.json")
    (group,) = document["groups"]
    assert (group["label"], group["runs"]) == ("all runs", ["run", "second"])
    finals = [r["final_pose_error_m"] for r in document["runs"]]
    assert group["means"]["final_pose_error_m"]["mean"] == pytest.approx(np.mean(finals))
    assert group["means"]["final_pose_error_m"]["half95"] > 0.0
    assert [r["name"] for r in document["runs"]] == ["run", "second"]
    assert document["runs"][0]["timing"]["match_us_median"] is None
    assert document["runs"][0]["ate_rmse_m"] == reports[0].figures["ate_rmse_m"]


def test_the_page_carries_what_the_figures_say(run, tmp_path, truth):
    (report,) = write_report([run], None, tmp_path / "r.html")
    (drawn,) = Page((tmp_path / "r.html").read_text()).data["runs"]
    path = {name: decoded(values) for name, values in drawn["path"].items()}
    assert path["t"][-1] == pytest.approx(report.figures["duration_s"], abs=1e-3)
    assert path["error"].max() == pytest.approx(report.figures["ate_max_m"], abs=1e-4)
    assert np.sqrt(np.mean(path["error"] ** 2)) == pytest.approx(
        report.figures["ate_rmse_m"], abs=1e-4
    )
    estimate = report.run.trajectory.poses
    assert np.column_stack([path["x"], path["y"]]) == pytest.approx(estimate[:, :2], abs=1e-3)
    off = np.hypot(path["truth_x"] - path["x"], path["truth_y"] - path["y"])
    assert off == pytest.approx(path["error"], abs=2e-3)
    assert np.abs(path["truth_heading"] - path["heading"]).max() < 90.0, "in the same turn"
    assert (path["odometry_x"][0], path["odometry_y"][0]) == (path["x"][0], path["y"][0])
    assert path["sigma"][99] == pytest.approx(math.sqrt(2e-6 * 100), abs=1e-4)
    assert path["speed"][600] == pytest.approx(
        np.hypot(*(estimate[605, :2] - estimate[595, :2])), abs=0.01
    )
    assert len(drawn["keyframes"]["t"]["steps"]) == report.figures["keyframes"]


def test_a_closure_is_drawn_where_it_was_measured(run, tmp_path):
    write_report([run], None, tmp_path / "r.html")
    (drawn,) = Page((tmp_path / "r.html").read_text()).data["runs"]
    closures = drawn["closures"]
    old, new = decoded(closures["old"]), decoded(closures["new"])
    assert (old.tolist(), new.tolist()) == ([3.0, 4.0], [98.0, 98.0])
    assert closures["accepted"] == [1, 0]
    assert closures["measured"] == [1, 0], "the rejected one has left no factor"
    assert (decoded(closures["x"])[0], decoded(closures["y"])[0]) == (0.05, 0.02)
    keyframes = {name: decoded(drawn["keyframes"][name]) for name in ("x", "y", "heading")}
    poses = np.column_stack([keyframes["x"], keyframes["y"], np.radians(keyframes["heading"])])
    in_graph = between(poses[4], poses[98])
    assert decoded(closures["x"])[1] == pytest.approx(in_graph[0], abs=2e-3)
    residual = np.hypot(*(between(poses[3], poses[98])[:2] - [0.05, 0.02]))
    assert decoded(closures["off_m"])[0] == pytest.approx(residual, abs=3e-3)
    assert math.isnan(decoded(closures["off_m"])[1])
    assert closures["reasons"][closures["reason"][1]] == HOSTILE
    assert set(closures["scans"]) == {"3", "4", "98"}
    scan = closures["scans"]["3"]
    assert (scan["first"], scan["step"], len(scan["ranges"]["steps"])) == (-180.0, 3.0, 120)


def test_runs_of_one_log_are_compared_pair_by_pair(run, tmp_path, truth):
    make_run(tmp_path / "worse", truth, seed=9)
    write_tum(tmp_path / "truth.tum", truth)
    runs = [run, tmp_path / "worse", run]
    reports = write_report(runs, tmp_path / "truth.tum", tmp_path / "r.html")
    worse, same = checked_json(tmp_path / "r.json")["paired"]
    errors = [report.errors.trans_m for report in reports]
    assert (worse["run"], worse["against"], worse["n"]) == ("worse", "run", 1200)
    assert worse["mean_m"] == pytest.approx(errors[1].mean())
    assert worse["difference_m"] == pytest.approx((errors[1] - errors[0]).mean())
    assert worse["smaller_share"] == pytest.approx(np.mean(errors[1] < errors[0]))
    assert worse["half95_m"] > abs(errors[1] - errors[0]).std() / math.sqrt(1200), "drift lasts"
    assert (same["difference_m"], same["half95_m"], same["smaller_share"]) == (0.0, 0.0, 0.0)
    assert "Errors pair by pair" in (tmp_path / "r.html").read_text()


def test_keyframes_that_were_pruned_are_read_under_both_names(tmp_path, truth):
    for name in ("pruned", "thinned_out"):
        run = bare_run(tmp_path / name, truth)
        (run / "summary.json").write_text(json.dumps({name: 7}))
        assert evaluate(run).figures["pruned"] == 7


def test_only_the_page_s_own_scripts_may_run(run, tmp_path):
    write_report([run], None, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text()
    (policy,) = re.findall(r'script-src ([^"]+)"', text)
    assert "unsafe" not in policy
    assert policy.count("sha256-") == len(Page(text).scripts)


def test_the_same_runs_give_the_same_page(run, tmp_path):
    write_report([run], None, tmp_path / "a.html")
    write_report([run], None, tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def bare_run(directory: Path, trajectory: Trajectory) -> Path:
    directory.mkdir()
    write_tum(directory / "trajectory.tum", trajectory)
    return directory


def test_a_bare_trajectory_without_truth_is_an_honest_partial_report(tmp_path, truth):
    run = bare_run(tmp_path / "run", truth)
    (report,) = write_report([run], None, tmp_path / "r.html")
    checked_json(tmp_path / "r.json")
    for word in ("keyframes.tum", "odometry.tum", "no map", "summary.json", "run.mcap", "no truth"):
        assert any(word in warning for warning in report.warnings)
        assert word in (tmp_path / "r.html").read_text()
    assert report.figures["ate_rmse_m"] is None


def test_one_pose_is_reported(tmp_path, truth):
    run = bare_run(tmp_path / "run", truth.select(np.arange(1)))
    write_tum(tmp_path / "truth.tum", truth)
    (report,) = write_report([run], tmp_path / "truth.tum", tmp_path / "r.html")
    checked_json(tmp_path / "r.json")
    assert report.figures["pairs"] == 1
    assert report.figures["final_pose_error_m"] is None
    assert any("only one pose" in warning for warning in report.warnings)
    assert report.figures["ate_rmse_m"] is None


def test_poses_that_are_not_finite_are_counted_and_left_out(tmp_path, truth):
    poses = truth.poses.copy()
    poses[5:8] = math.nan
    run = bare_run(tmp_path / "run", Trajectory(truth.stamps_ns, poses))
    write_tum(tmp_path / "truth.tum", truth)
    (report,) = write_report([run], tmp_path / "truth.tum", tmp_path / "r.html")
    checked_json(tmp_path / "r.json")
    assert "trajectory.tum: 3 of 1200 poses are not finite and are left out" in report.warnings
    assert report.figures["ate_rmse_m"] < 1e-12


def test_truth_for_half_of_the_run_is_said(tmp_path, truth, run):
    write_tum(tmp_path / "half.tum", truth.select(np.arange(600)))
    report = evaluate(run, tmp_path / "half.tum")
    assert any("covers only 50%" in warning for warning in report.warnings)
    assert report.figures["pairs"] == 600


def test_truth_of_another_day_is_said(tmp_path, run):
    other = drive(400, seed=5)
    rng = np.random.default_rng(0)
    poses = np.cumsum(rng.normal(0, 0.1, (400, 3)), axis=0)
    write_tum(tmp_path / "other.tum", Trajectory(other.stamps_ns + 86_400 * NS, poses))
    (report,) = write_report([run], tmp_path / "other.tum", tmp_path / "r.html")
    checked_json(tmp_path / "r.json")
    assert any("no pose of the run has a true one" in warning for warning in report.warnings)
    assert report.figures["ate_rmse_m"] is None


@pytest.mark.parametrize(("shift_s", "said"), [(3600.0, "corrected"), (1.5, "not corrected")])
def test_a_clock_offset_is_found_and_said(tmp_path, run, truth, shift_s, said):
    shifted = Trajectory(truth.stamps_ns + round(shift_s * NS), truth.poses)
    write_tum(tmp_path / "late.tum", shifted)
    report = evaluate(run, tmp_path / "late.tum")
    (warning,) = [w for w in report.warnings if w.startswith("clock offset")]
    found = float(re.search(r"clock is ([+-][\d.]+) s", warning).group(1))
    assert found == pytest.approx(shift_s, abs=0.05)
    assert f"figures are {said} for it" in warning
    assert (report.figures["ate_rmse_m"] < 0.5) == (said == "corrected")


def test_no_clock_offset_is_claimed_where_there_is_none(truth):
    assert find_clock_offset(drifted(truth, 0.01), truth) is None
    still = Trajectory(truth.stamps_ns, np.zeros((len(truth), 3)))
    assert find_clock_offset(still, truth) is None
    assert find_clock_offset(truth.select(np.arange(3)), truth) is None


def test_what_cannot_be_read_is_one_clear_line(tmp_path, run):
    with pytest.raises(ReportError, match="no such run directory"):
        evaluate(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ReportError, match=r"holds no trajectory\.tum"):
        evaluate(tmp_path / "empty")
    (tmp_path / "empty" / "trajectory.tum").write_text("")
    with pytest.raises(ReportError, match="holds no pose"):
        evaluate(tmp_path / "empty")
    with pytest.raises(ReportError, match="cannot be read"):
        evaluate(run, tmp_path / "no.truth")
    with pytest.raises(ReportError, match="no run was given"):
        write_report([], None, tmp_path / "r.html")
    with pytest.raises(ReportError, match="cannot be written"):
        write_report([run], None, tmp_path / "no" / "such" / "r.html")


def test_a_damaged_log_or_summary_costs_only_its_part(tmp_path, truth):
    run = bare_run(tmp_path / "run", truth)
    (run / "run.mcap").write_bytes(b"\x89MCAP0\r\n and then nothing")
    (run / "summary.json").write_text("{")
    warnings = evaluate(run).warnings
    assert any("run.mcap is damaged" in warning for warning in warnings)
    assert any("summary.json is not JSON" in warning for warning in warnings)


@pytest.mark.parametrize(
    ("name", "line", "kind"),
    [
        ("a.txt", "1.0 2.0 0 0 0 0 0 1", "trajectory"),
        ("b.txt", "1.0 2.0 1 0 0 0 0 0.5", "relations"),
        ("c.txt", "1.0, 2.0, 3.0, 0.5", "survey"),
    ],
)
def test_the_kind_of_truth_is_seen_from_its_first_line(tmp_path, name, line, kind):
    (tmp_path / name).write_text(f"# truth\n{line}\n")
    assert read_truth(tmp_path / name).kind == kind


def test_a_bad_survey_line_is_named(tmp_path):
    (tmp_path / "s.csv").write_text("t,x,y,theta\n1,2,3\n")
    with pytest.raises(ReportError, match=r"s\.csv:2: not a surveyed pose"):
        read_truth(tmp_path / "s.csv")


def test_numbers_for_people():
    assert format_number(None) == format_number(math.nan) == "\N{EN DASH}"
    assert format_number(1234.5678, 2) == "1\N{NARROW NO-BREAK SPACE}234.57"
    assert format_number("text") == "text"
