"""Batches: grids, sources, tasks, and the table; a tiny grid on two real worker processes."""

import http.server
import io
import json
import os
import signal
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from slam.logs.mcap_log import open_log

from slam.cli.main import main
from slam.experiments.batch.batch import Batch, run_batch
from slam.experiments.batch.engine import BatchError, engine, run_tasks
from slam.experiments.batch.grid import make_grid
from slam.experiments.batch.progress import TaskProgress
from slam.experiments.batch.report import compare
from slam.experiments.batch.run_batch import make_task
from slam.experiments.batch.sources import expand, find_truth, local_copy
from slam.experiments.batch.table import is_time, make_row, parquet
from slam.experiments.batch.task import log_hash, read_result, run_task
from slam.mapping.config import SlamConfig
from slam.runs.errors import ConfigError, ReportError
from slam.runs.replay import file_sha256
from slam.tools.simulate import simulate_log

WORLD = "testbed-180cm"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two short drives, a log cut short, and a file that is none."""
    folder = tmp_path_factory.mktemp("logs")
    for seed in (0, 1):
        simulate_log(WORLD, folder / f"drive{seed}.mcap", seed, "hokuyo-181", "typical")
    (folder / "cut.mcap").write_bytes((folder / "drive0.mcap").read_bytes()[:5000])
    (folder / "text.mcap").write_text("no log at all\n")
    return folder


@pytest.fixture(scope="module")
def client():
    with engine(2) as client:
        yield client


# Grids


def test_a_grid_holds_every_combination_the_last_setting_fastest():
    grid = make_grid(None, ["keyframes.method=sdp-pe,constant", "keyframes.interval=0.2,0.4"])
    assert [point.values for point in grid.points] == [
        ("sdp-pe", "0.2"), ("sdp-pe", "0.4"), ("constant", "0.2"), ("constant", "0.4"),
    ]  # fmt: skip
    configs = [point.config.keyframes for point in grid.points]
    assert [(c.method, c.interval) for c in configs][2] == ("constant", 0.2)
    assert grid.label(grid.points[1]) == "keyframes.method=sdp-pe keyframes.interval=0.4"


def test_commas_within_lists_and_quotes_do_not_cut():
    grid = make_grid(None, ["keyframes.weights=[1, 2, 3, 4],[4,3,2,1]"])
    assert [point.config.keyframes.weights for point in grid.points] == [(1, 2, 3, 4), (4, 3, 2, 1)]
    assert make_grid(None, ["keyframes.method='constant'"]).points[0].config is not None


def test_no_setting_is_one_combination():
    grid = make_grid(None, [])
    assert [point.config for point in grid.points] == [SlamConfig()]


@pytest.mark.parametrize(
    ("settings", "wrong"),
    [
        (["keyframes.intervall=0.2,0.3"], "unknown setting keyframes.intervall; did you mean"),
        (["keyframes.interval"], "expected section.key=value"),
        (["keyframes.interval=1", "keyframes.interval=2"], "given more than once"),
        (["keyframes.interval=-1,-2"], "greater than 0"),
        (["keyframes=1"], "is a section"),
    ],
)
def test_what_no_combination_can_mend_is_refused_at_once(settings, wrong):
    with pytest.raises(ConfigError, match=wrong):
        make_grid(None, settings)


def test_combinations_that_do_not_work_spoil_no_others():
    limits = ["keyframes.min_interval=0.2,0.6", "keyframes.max_interval=0.4,0.8"]
    points = make_grid(None, limits).points
    assert [point.config is None for point in points] == [False, False, True, False]
    assert "min_interval must not exceed" in points[2].reason


# Sources


def test_logs_come_from_paths_patterns_and_addresses(logs, monkeypatch):
    monkeypatch.chdir(logs)
    assert expand(["drive*.mcap", "drive0.mcap", "no*.mcap"]) == [
        "drive0.mcap", "drive1.mcap", "no*.mcap",
    ]  # fmt: skip
    assert expand([f"file://{logs}/drive*.mcap"]) == [
        f"file://{logs}/drive{k}.mcap" for k in (0, 1)
    ]
    with local_copy(f"file://{logs}/drive0.mcap") as path:
        assert path == logs / "drive0.mcap"


def test_a_remote_log_is_fetched_for_as_long_as_it_is_needed(logs, tmp_path):
    handler = partial(_Silent, directory=str(logs))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        with local_copy(f"{address}/drive0.mcap", tmp_path) as path:
            assert path.name == "drive0.mcap"
            assert path.read_bytes() == (logs / "drive0.mcap").read_bytes()
        assert not any(tmp_path.iterdir())
        with pytest.raises(FileNotFoundError), local_copy(f"{address}/none.mcap", tmp_path):
            pass
        assert not any(tmp_path.iterdir())
        server.shutdown()


class _Silent(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


def test_the_truth_of_a_log_has_its_name(tmp_path):
    (tmp_path / "a.tum").write_text("")
    (tmp_path / "b.tum").write_text("")
    (tmp_path / "b.relations").write_text("")
    assert find_truth(None, "a.mcap") is None
    assert find_truth(tmp_path, "http://host/x/a.mcap") == tmp_path / "a.tum"
    assert find_truth(tmp_path, "c.mcap") is None
    with pytest.raises(ReportError, match=r"several truths of b: .*b.relations, b.tum"):
        find_truth(tmp_path, "b.mcap")


# One task


def task_of(log, results, config=None):
    return make_task(str(log), file_sha256(log), config or SlamConfig(), None, results)


def test_a_task_leaves_the_figures_of_its_replay(logs, tmp_path):
    task = task_of(logs / "drive0.mcap", tmp_path)
    assert read_result(task) is None
    run_task(task)
    record = read_result(task)
    assert record["status"] == "ok"
    assert record["figures"]["ate_rmse_m"] < 0.05
    assert record["summary"]["scans"] > 50
    assert [path.name for path in tmp_path.iterdir()] == [f"{task.key}.json"]


def test_a_task_is_judged_by_the_truth_in_the_folder(logs, tmp_path):
    log = logs / "drive0.mcap"
    with open_log(log) as opened:
        stamps = [m.stamp_ns for m in opened.messages(("/truth",))]
    relation = f"{stamps[0] / 1e9:.6f} {stamps[-1] / 1e9:.6f} 1.80 0 0 0 0 0\n"
    (tmp_path / "drive0.relations").write_text(relation)
    task = make_task(str(log), file_sha256(log), SlamConfig(), tmp_path, tmp_path)
    run_task(task)
    relations = read_result(task)["figures"]["relations"]
    assert (relations["n"], relations["missing"]) == (1, 0)
    assert relations["trans_mean_m"] < 0.05


def test_results_are_known_by_contents_not_by_places(logs, tmp_path):
    task = task_of(logs / "drive0.mcap", tmp_path)
    copy = tmp_path / "copy.mcap"
    copy.write_bytes((logs / "drive0.mcap").read_bytes())
    assert task_of(copy, tmp_path).key == task.key
    truth = tmp_path / "copy.tum"
    truth.write_text("0 0 0 0 0 0 0 1\n")
    others = [
        task_of(logs / "drive1.mcap", tmp_path),
        task_of(logs / "drive0.mcap", tmp_path, SlamConfig(odometry={"lost_inflation": 2.0})),
        make_task(str(copy), file_sha256(copy), SlamConfig(), tmp_path, tmp_path),
        replace(task, version="0.0.0"),
    ]
    assert len({task.key, *(other.key for other in others)}) == 5


def test_what_is_wrong_with_a_log_is_a_result(logs, tmp_path):
    task = task_of(logs / "cut.mcap", tmp_path)
    run_task(task)
    record = read_result(task)
    assert record["status"] == "failed"
    assert record["reason"].startswith("{log}: was not closed properly")


def test_what_may_be_mended_is_no_result(logs, tmp_path):
    task = task_of(logs / "drive0.mcap", tmp_path)
    with pytest.raises(BatchError, match="version"):
        run_task(replace(task, version="0.0.0"))
    with pytest.raises(BatchError, match="has changed"):
        run_task(replace(task, log_sha256="0" * 64))
    with pytest.raises(FileNotFoundError):
        log_hash(str(logs / "none.mcap"))
    assert not any(tmp_path.iterdir())


def test_half_a_result_is_none(logs, tmp_path):
    task = task_of(logs / "drive0.mcap", tmp_path)
    task.result.write_text('{"status": "ok", ')
    assert read_result(task) is None


# Table and report


def rows_of(grid, *errors):
    """A row for each error; None is a log that failed."""
    return [
        make_row(
            f"log{k // len(grid.points)}", grid, grid.points[k % len(grid.points)], {},
            {"status": "failed", "reason": "{log}: broken"} if error is None else {
                "status": "ok", "reason": "", "seconds": 1.0,
                "summary": {"matches": 10, "lost": {}}, "figures": {"ate_rmse_m": error},
            },
        )
        for k, error in enumerate(errors)
    ]  # fmt: skip


def test_columns_of_settings_are_numbers_where_all_values_are():
    grid = make_grid(None, ["keyframes.interval=0.2,1", "loops.places=1,2"])
    table = pq.read_table(io.BytesIO(parquet(rows_of(grid, 0.1, 0.2, 0.3, 0.4), grid)))
    assert table.schema.field("keyframes.interval").type == pa.float64()
    assert table.schema.field("loops.places").type == pa.int64()
    assert table.column("keyframes.interval").to_pylist() == [0.2, 0.2, 1.0, 1.0]
    mixed = make_grid(None, ["keyframes.weights=[1,2,3,4],[1,1,1,1]"])
    table = pq.read_table(io.BytesIO(parquet(rows_of(mixed, 0.1, 0.2), mixed)))
    assert table.column("keyframes.weights").to_pylist() == ["[1, 2, 3, 4]", "[1, 1, 1, 1]"]


def test_settings_are_compared_log_by_log():
    grid = make_grid(None, ["keyframes.interval=0.2,0.4"])
    rows = rows_of(grid, 0.1, 0.05, 1.0, 0.5, 0.3, None)
    first, second = compare(rows, grid)
    assert (first["error_ratio"], first["better"], first["failed"]) == (1.0, 0, 0)
    assert second["error_ratio"] == pytest.approx(0.5)
    assert second["error_ratio_low"] == pytest.approx(0.5)
    assert (second["compared"], second["better"], second["failed"]) == (2, 2, 1)
    assert rows[-1]["reason"] == "log2: broken"


def test_progress_says_how_far_and_how_long():
    progress = TaskProgress("replays", 4)
    progress.tick(failed=False)
    progress.tick(failed=True)
    assert progress.line(60.0) == "replays: 2 of 4, 1 failed, 0:01:00 to go"


# On workers


def square(x):
    if x == 3:
        raise ValueError("no threes")
    return x * x, os.getpid(), os.environ["OMP_NUM_THREADS"]


def test_tasks_run_in_processes_of_one_thread_each_and_errors_come_back(client):
    found = dict(run_tasks(client, square, range(6)))
    assert sorted(found) == list(range(6))
    assert isinstance(found.pop(3), ValueError)
    assert {k: value[0] for k, value in found.items()} == {k: k * k for k in found}
    assert os.getpid() not in {value[1] for value in found.values()}
    assert {value[2] for value in found.values()} == {"1"}


def test_a_batch_finishes_what_can_be_finished_and_repeats_nothing(client, logs, tmp_path):
    grid = make_grid(None, ["keyframes.interval=0.3,0.5,-1", "keyframes.method=constant"])
    addresses = [f"{logs}/*.mcap", str(logs / "none.mcap")]
    said = []
    rows = run_batch(Batch(addresses, grid, tmp_path), client, said.append)
    status = {(Path(r["log"]).stem, r["keyframes.interval"]): r["status"] for r in rows}
    good = {(f"drive{k}", interval) for k in (0, 1) for interval in (0.3, 0.5)}
    assert {key for key, value in status.items() if value == "ok"} == good
    assert len(rows) == 5 * 3
    reasons = {row["reason"] for row in rows}
    assert f"{logs}/none.mcap: no such file" in reasons
    assert any("is not an MCAP log" in reason for reason in reasons)
    assert any("keyframes.interval: Input should be greater than 0" in r for r in reasons)
    report = json.loads((tmp_path / "report.json").read_text())
    assert [s["failed"] for s in report["settings"]] == [3, 3, 5]
    assert "none.mcap: no such file" in (tmp_path / "report.html").read_text()

    before = outcome(tmp_path)
    results = sorted((tmp_path / "results").iterdir())
    removed, kept = results[0], {path: path.stat().st_mtime_ns for path in results[1:]}
    removed.unlink()
    run_batch(Batch(addresses, grid, tmp_path), client, said.append)
    assert said == [f"replays: {len(kept)} of {len(results)} are there already"]
    assert sorted((tmp_path / "results").iterdir()) == results
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert outcome(tmp_path) == before


def outcome(out):
    """What a batch left, but for the times."""
    table = pq.read_table(out / "table.parquet")
    kept = table.drop_columns([name for name in table.column_names if is_time(name)])
    return kept.to_pylist(), *((out / f"report.{kind}").read_bytes() for kind in ("json", "html"))


# The command


def slam(capsys, monkeypatch, *arguments):
    """Exit code and last words of a command that ends before any worker starts."""
    monkeypatch.setattr(sys, "argv", ["slam", *map(str, arguments)])
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code, capsys.readouterr().err.strip()


def test_a_missing_extra_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "optuna", None)
    code, said = slam(capsys, monkeypatch, "batch", "a.mcap", "--out", tmp_path / "out")
    assert code == 1
    assert said == "slam: this command needs the extra batch: pip install 'sdp-slam[batch]'"


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        (["batch", "a.mcap", "--set", "keyframes.intervall=1,2"], 1, "unknown setting"),
        (["batch", "a.mcap", "--workers", "2", "--scheduler", "tcp://x:1"], 2, "say one"),
        (["batch", "a.mcap", "--workers", "0"], 2, "--workers"),
        (["tune", "--train", "a.mcap", "--param", "keyframes.t_hihg=1:2"], 1, "did you mean"),
        (
            ["tune", "--train", "a.mcap", "--param", "loops.places=1:2", "--objective", "speed"],
            1, "known are relations, ate, matches",
        ),
    ],
)  # fmt: skip
def test_wrong_requests_are_refused_before_anything_is_made(
    capsys, monkeypatch, tmp_path, arguments, code, line
):
    out = tmp_path / "out"
    monkeypatch.setenv("COLUMNS", "200")
    found, said = slam(capsys, monkeypatch, *arguments, "--out", out)
    assert found == code
    assert line in said
    assert not out.exists()
