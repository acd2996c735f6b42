"""The command as people run it: bad input gives one line and an exit code, and spoils nothing."""

from __future__ import annotations

import ctypes
import gzip
import io
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from slam.cli.main import main

ROOT = Path(__file__).parents[3]
SLAM = [sys.executable, "-m", "slam"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}


def slam(*arguments, cwd=None, **options):
    return subprocess.run(
        [*SLAM, *map(str, arguments)], cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True,
        timeout=120, check=False, **options,
    )  # fmt: skip


def write(path, messages):
    with LogWriter(path, {}) as log:
        for message in messages:
            log.write(message)


def carmen(scans=40, beams=180, change=lambda k, ranges: ranges, stamp=lambda k: 100 + 0.1 * k):
    """A CARMEN log of a drive along a corridor 4 m wide."""
    lines = []
    for k in range(scans):
        ranges = [2 / max(abs(math.cos(math.radians(b - 90))), 0.2) for b in range(beams)]
        numbers = " ".join(f"{r:.2f}" for r in change(k, ranges))
        x = 0.05 * k
        lines.append(f"FLASER {beams} {numbers} {x} 0 0 {x} 0 0 {stamp(k)} host {stamp(k)}")
    return "\n".join(lines) + "\n"


def odd_readings(k, ranges):
    return [float("nan"), -1.0, *ranges[2:]] if k == 5 else ranges


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A folder with logs that have something wrong with them, and one that has not."""
    folder = tmp_path_factory.mktemp("inputs")
    good = list(simulate(scenario("testbed-180cm")))
    inf = np.full(181, np.inf, dtype=np.float32)
    logs = {
        "good": good,
        "no-messages": [],
        "no-scans": [m for m in good if not isinstance(m, LaserScan)],
        "one-scan": good[:4],
        "no-odometry": [m for m in good if not isinstance(m, WheelOdometry)],
        "odometry-only": [m for m in good if isinstance(m, LaserExtrinsics | WheelOdometry)],
        "nothing-seen": [
            replace(m, ranges=inf.copy()) if isinstance(m, LaserScan) else m for m in good
        ],
        "reversed": [good[0], *good[:0:-1]],
        "nan-odometry": [
            replace(m, theta=math.nan) if isinstance(m, WheelOdometry) and k in (61, 91) else m
            for k, m in enumerate(good)
        ],
    }
    for name, messages in logs.items():
        write(folder / f"{name}.mcap", messages)
    whole = (folder / "good.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "text.mcap").write_text("this is no log\n" * 40)
    (folder / "empty.log").write_bytes(b"")
    (folder / "beams.log").write_text(carmen(change=lambda k, r: r[:170] if k == 3 else r))
    (folder / "all-beams.log").write_text(carmen(change=lambda k, r: r[:170]))
    (folder / "readings.log").write_text(carmen(change=odd_readings))
    (folder / "backwards.log").write_text(carmen(stamp=lambda k: 100.0 + 0.1 * (k - 3 * (k == 9))))
    cut = gzip.compress(carmen().encode())
    (folder / "cut.log.gz").write_bytes(cut[: len(cut) * 2 // 3])
    (folder / "typo.toml").write_text("[keyframes]\nintervall = 3\n")
    (folder / "folder").mkdir()
    (folder / "taken").mkdir()
    (folder / "taken" / "mine").write_text("mine")
    (folder / "file").write_text("mine")
    return folder


@dataclass
class Case:
    """A command that must end with one line that says what is wrong, where, and what to do."""

    command: str
    code: int
    says: tuple[str, ...]
    makes: tuple[str, ...] = field(default=())  # what it may leave behind, in its own folder


# These run as a process of their own, the others within this one, to save time.
APART = {"truncated log", "out is there", "no out", "config typo", "wrong beam count once", "help"}


CASES = {
    # replay: logs
    "empty log": Case("replay empty.mcap --out OUT", 1, ("empty.mcap", "is empty")),
    "truncated log": Case("replay cut.mcap --out OUT", 1, ("cut.mcap", "slam recover cut.mcap")),
    "no log at all": Case("replay text.mcap --out OUT", 1, ("text.mcap",)),
    "missing log": Case("replay nowhere.mcap --out OUT", 1, ("nowhere.mcap", "no such file")),
    "log is a folder": Case("replay folder --out OUT", 1, ("folder", "is a folder")),
    "no messages": Case("replay no-messages.mcap --out OUT", 1, ("no usable scan among 0",)),
    "no scans": Case("replay no-scans.mcap --out OUT", 1, ("no usable scan among 0",)),
    "odometry only": Case("replay odometry-only.mcap --out OUT", 1, ("no usable scan among 0",)),
    "no odometry": Case("replay no-odometry.mcap --out OUT", 0, ("by the laser alone",), ("OUT",)),
    "nothing seen": Case("replay nothing-seen.mcap --out OUT", 1, ("no usable scan among 74",)),
    "one scan": Case("replay one-scan.mcap --out OUT", 0, ("1 scans, 1 keyframes",), ("OUT",)),
    "nan odometry": Case(
        "replay nan-odometry.mcap --out OUT", 3, ("lost: ", "odometry that is not finite"), ("OUT",)
    ),
    "reversed log": Case(
        "replay reversed.mcap --out OUT", 3, ("73 scan with a stamp that runs backwards",), ("OUT",)
    ),
    "no raw bytes": Case("replay good.mcap --from raw --out OUT", 1, ("holds no raw bytes",)),
    # replay: output
    "out is there": Case("replay good.mcap --out taken", 1, ("taken", "exists already", "--out")),
    "out is a file": Case("replay good.mcap --out file", 1, ("file", "exists already")),
    "out below a file": Case(
        "replay good.mcap --out file/run", 1, ("file/run", "Not a directory", "--out")
    ),
    "out where nothing can be": Case(
        "replay good.mcap --out /proc/nowhere/run", 1, ("/proc/nowhere/run", "cannot be written")
    ),
    "broken log, new folders": Case("replay cut.mcap --out new/er/run", 1, ("slam recover",)),
    "no out": Case("replay good.mcap", 2, ("--out",)),
    # settings
    "config typo": Case(
        "replay good.mcap --out OUT --config typo.toml", 1,
        ("typo.toml", "keyframes.intervall", "did you mean keyframes.interval?"),
    ),
    "missing config": Case("replay good.mcap --out OUT --config no.toml", 1, ("no.toml",)),
    "unknown setting": Case(
        "replay good.mcap --out OUT --set loop.places=3", 1, ("--set", "did you mean loops?")
    ),
    "setting out of range": Case(
        "replay good.mcap --out OUT --set keyframes.interval=-1", 1, ("keyframes.interval", "-1")
    ),
    # import
    "empty import": Case("import empty.log --out OUT.mcap", 1, ("empty.log", "is empty")),
    "missing import": Case("import nowhere.log --out OUT.mcap", 1, ("nowhere.log",)),
    "import of a folder": Case("import folder --out OUT.mcap", 1, ("folder", "is a folder")),
    "import of a text": Case("import typo.toml --out OUT.mcap", 1, ("typo.toml", "CARMEN")),
    "import of our own": Case("import good.mcap --out OUT.mcap", 1, ("slam replay",)),
    "wrong beam count once": Case(
        "import beams.log --out OUT.mcap", 3, ("skipped: 1 FLASER", "beams"), ("OUT.mcap",)
    ),
    "wrong beam count always": Case(
        "import all-beams.log --out OUT.mcap", 1, ("all-beams.log", "no usable scan")
    ),
    "nan and negative ranges": Case(
        "import readings.log --out OUT.mcap", 0, ("2 ranges", "set to nan"), ("OUT.mcap",)
    ),
    "stamps that run backwards": Case(
        "import backwards.log --out OUT.mcap", 0, ("1 stamps that ran backwards",), ("OUT.mcap",)
    ),
    "gzip cut off": Case(
        "import cut.log.gz --out OUT.mcap", 3, ("skipped: 1", "cut off"), ("OUT.mcap",)
    ),
    "import to nowhere": Case(
        "import readings.log --out none/OUT.mcap", 1, ("none/OUT.mcap", "choose another")
    ),
    # the others
    "world typo": Case("simulate testbd --out OUT.mcap", 1, ("testbd", "did you mean testbed?")),
    "laser typo": Case(
        "simulate testbed --laser hokyuo-181 --out OUT.mcap", 1, ("did you mean hokuyo-181?",)
    ),
    "negative seed": Case("simulate testbed --seed -1 --out OUT.mcap", 2, ("--seed",)),
    "simulate to nowhere": Case("simulate testbed", 2, ("--out",)),
    "report on nothing": Case("report nowhere", 1, ("nowhere", "no such run")),
    "report on a folder": Case("report taken", 1, ("taken", "slam replay")),
    "info on a cut log": Case("info cut.mcap", 1, ("slam recover",)),
    "doctor on a cut log": Case("doctor cut.mcap", 1, ("slam recover",)),
    "recover a cut log": Case(
        "recover cut.mcap --out OUT.mcap", 3, ("messages saved",), ("OUT.mcap",)
    ),
    "recover nothing": Case("recover empty.mcap --out OUT.mcap", 1, ("empty.mcap", "is empty")),
    "export to nowhere": Case("export good.mcap --carmen none/x.clf", 1, ("none/x.clf",)),
    "export to nothing": Case("export good.mcap", 2, ("--ros2",)),
    "graph of a log": Case("export good.mcap --g2o OUT.g2o", 1, ("a log has no graph",)),
    "help of import": Case("import --help", 0, ("BreezySLAM", "ROS", ".db3", "g2o")),
    "demo where something is": Case("demo --out taken", 1, ("taken", "exists already")),
    "unknown command": Case("replya good.mcap", 2, ("replya",)),
    "list of worlds": Case("simulate list", 0, ("testbed", "office")),
    "help": Case("replay --help", 0, ("--config", "--set")),
}  # fmt: skip


def within(arguments: list[str]) -> tuple[int, str, str]:
    """Run the command in this process: exit code, stdout, stderr; what it raises gets through."""
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    said, talk = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), redirect_stderr(talk):
        patch.setattr(sys, "argv", ["slam", *arguments])
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    return code, said.getvalue(), talk.getvalue()


@pytest.fixture
def workplace(inputs, tmp_path):
    """A folder of its own with links to the inputs."""
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_bad_input_is_answered_with_a_line_and_an_exit_code(inputs, workplace, name):
    case = CASES[name]
    if name in APART:
        done = slam(*case.command.split(), cwd=workplace)
        code, said, talk = done.returncode, done.stdout, done.stderr
    else:
        with chdir(workplace):
            code, said, talk = within(case.command.split())
    assert "Traceback" not in talk
    for words in case.says:
        assert words in said + talk
    assert code == case.code, talk
    assert {p.name for p in workplace.iterdir() if not p.is_symlink()} == set(case.makes)
    if case.code == 1:
        assert said == ""
        (line,) = talk.strip().splitlines()
        assert line.startswith("slam: ")
    assert (inputs / "file").read_text() == "mine"
    assert [p.name for p in (inputs / "taken").iterdir()] == ["mine"]


def _without_roots_rights() -> None:
    """Let permissions count for root as well: drop CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH."""
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


@pytest.mark.skipif(sys.platform != "linux", reason="permissions are dropped the way of Linux")
@pytest.mark.parametrize("what", ["log", "folder"])
def test_missing_permission_is_named(inputs, tmp_path, what):
    log, folder = tmp_path / "good.mcap", tmp_path / "folder"
    log.write_bytes((inputs / "good.mcap").read_bytes())
    folder.mkdir()
    closed = log if what == "log" else folder
    closed.chmod(0o000 if what == "log" else 0o555)
    out = folder / "run"
    done = slam("replay", log, "--out", out, preexec_fn=_without_roots_rights)
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith(f"slam: {log if what == 'log' else out}: ")
    assert "Permission denied" in line
    assert done.returncode == 1
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def long_log(tmp_path_factory):
    """A drive that takes several seconds to replay."""
    path = tmp_path_factory.mktemp("long") / "office.mcap"
    write(path, simulate(scenario("office")))
    return path


def partial_of(out: Path) -> Path:
    return out.with_name(out.name + ".partial")


@pytest.mark.parametrize(
    ("number", "code", "word"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")],
)
@pytest.mark.parametrize("begun", [False, True])
def test_a_signal_ends_a_replay_cleanly(long_log, tmp_path, number, code, word, begun):
    """While modules are loaded, and in the middle of the work."""
    out = tmp_path / "deep" / "run"
    process = subprocess.Popen(
        [*SLAM, "replay", str(long_log), "--out", str(out)], env=ENVIRONMENT,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    if begun:
        _wait_until(partial_of(out).exists)
        time.sleep(0.2)
    else:
        time.sleep(0.6)
    process.send_signal(number)
    said, talk = process.communicate(timeout=60)
    assert process.returncode == code, talk
    assert said == ""
    assert talk == f"slam: {word}; nothing half-written is left\n"
    assert list(tmp_path.iterdir()) == []


def test_a_signal_that_comes_before_anything_is_loaded(tmp_path):
    """A stand-in for the first library that the commands need takes its time to load."""
    slow = "import sys, time\nprint('loading', file=sys.stderr, flush=True)\ntime.sleep(60)\n"
    (tmp_path / "typer.py").write_text(slow, encoding="ascii")
    path = os.pathsep.join([str(tmp_path), ENVIRONMENT["PYTHONPATH"]])
    process = subprocess.Popen(
        [*SLAM, "--help"],
        env={**ENVIRONMENT, "PYTHONPATH": path},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr.readline() == "loading\n"
    process.send_signal(signal.SIGINT)
    _, talk = process.communicate(timeout=60)
    assert (process.returncode, talk) == (130, "slam: interrupted; nothing half-written is left\n")


def _wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(scope="module")
def twice(inputs, tmp_path_factory):
    """The same log replayed by two processes at the same time."""
    folder = tmp_path_factory.mktemp("twice")
    log = folder / "bed.mcap"
    write(log, list(simulate(scenario("office", 3), seed=3))[:1500])

    def one(name):
        done = slam("replay", log, "--out", folder / name)
        assert done.returncode == 0, done.stderr
        return folder / name

    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(one, ["one", "other"]))


def _full_disk(size: int) -> Callable[[], None]:
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.parametrize(
    "command",
    ["replay good.mcap --out OUT", "import readings.log --out OUT.mcap", "demo --out OUT"],
)  # fmt: skip
def test_a_full_disk_leaves_nothing_behind(inputs, tmp_path, twice, command):
    """Files may not grow beyond 8 kB; the kernels were compiled for the runs before."""
    for name in ("good.mcap", "readings.log"):
        (tmp_path / name).symlink_to(inputs / name)
    done = slam(*command.split(), cwd=tmp_path, preexec_fn=_full_disk(8192))
    assert "Traceback" not in done.stderr
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("slam: ")
    assert "File too large" in last
    assert sorted(p.name for p in tmp_path.iterdir()) == ["good.mcap", "readings.log"]


FILES = {
    "run.mcap", "trajectory.tum", "keyframes.tum", "odometry.tum", "graph.g2o", "graph.times.csv",
    "map.pgm", "map.yaml", "map.png", "summary.json",
}  # fmt: skip


def test_a_run_holds_what_is_promised(twice):
    run, _ = twice
    assert {p.name for p in run.iterdir()} == FILES
    summary = json.loads((run / "summary.json").read_text())
    promised = {
        "log", "scans", "keyframes", "matches", "loops", "distance_m", "duration_s", "timing",
        "peak_rss_mb", "lost", "version", "config_sha256",
    }  # fmt: skip
    assert promised <= set(summary)
    assert set(summary["loops"]) == {"candidates", "accepted", "rejected"}
    assert {
        "wall_s", "cpu_s", "realtime_factor", "match_us_median", "step_ms_p50", "step_ms_p99",
    } <= set(summary["timing"])  # fmt: skip
    assert summary["scans"] == len((run / "trajectory.tum").read_text().splitlines())
    assert summary["keyframes"] == len((run / "keyframes.tum").read_text().splitlines())
    yaml = (run / "map.yaml").read_text()
    assert "occupied_thresh: 0.65" in yaml
    assert "free_thresh: 0.196" in yaml


@pytest.mark.parametrize(
    "name", ["trajectory.tum", "graph.g2o", "keyframes.tum", "graph.times.csv", "map.pgm"]
)
def test_two_processes_make_the_same_bytes(twice, name):
    one, other = twice
    assert (one / name).read_bytes() == (other / name).read_bytes()


def test_a_report_of_two_runs(twice, tmp_path):
    page = tmp_path / "report.html"
    done = slam("report", *twice, "--out", page)
    assert done.returncode == 0, done.stderr
    assert "ATE" in done.stdout
    runs = json.loads((tmp_path / "report.json").read_text())["runs"]
    assert [run["name"] for run in runs] == ["one", "other"]
    for run in runs:
        assert run["ate_rmse_m"] < 0.05
        assert run["final_pose_error_m"] < 0.1
        assert {"ate_median_m", "rpe", "anees", "matches", "keyframes", "timing"} <= set(run)
    assert page.read_text().startswith("<!")


def test_a_report_of_several_runs_overwrites_none_of_theirs(twice):
    done = slam("report", *twice)
    assert done.returncode == 2
    assert "several runs need --out PAGE" in done.stderr
    assert not (twice[0] / "report.html").exists()


def test_relations_of_another_drive_are_a_note(twice, tmp_path):
    relations = tmp_path / "other.relations"
    relations.write_text("1.0 2.0 0 0 0 0 0 0\n")
    done = slam("report", twice[0], "--truth", relations, "--out", tmp_path / "report.html")
    assert done.returncode == 0, done.stderr
    assert "is this its truth?" in done.stderr + done.stdout


def test_info_says_what_a_log_holds(inputs):
    done = slam("info", inputs / "good.mcap")
    assert done.returncode == 0
    for words in ("/scan", "/odom", "/truth", "10.00 Hz"):
        assert words in done.stdout


def test_export_and_import_give_the_same_log_back(inputs, tmp_path):
    assert slam("export", inputs / "good.mcap", "--carmen", tmp_path / "x.clf").returncode == 0
    done = slam("import", tmp_path / "x.clf", "--out", tmp_path / "x.mcap")
    assert done.returncode == 0, done.stderr
    assert "74 scans" in done.stderr


def test_ten_times_the_data_takes_ten_times_as_long_and_no_more_than_twice_the_memory(tmp_path):
    """A robot that patrols a room: the same 8 s of driving, once and ten times."""
    lap = list(simulate(scenario("testbed-180cm"), seed=1))
    stamps = [m.stamp_ns for m in lap]
    period = stamps[-1] - stamps[0] + 100_000_000
    there = [m for m in lap if not isinstance(m, TruePose | LaserExtrinsics)]
    back = [replace(m, stamp_ns=stamps[-1] + stamps[0] - m.stamp_ns) for m in there]
    back.sort(key=lambda m: (m.stamp_ns, isinstance(m, LaserScan)))
    patrol = []
    for k in range(20):
        patrol += [replace(m, stamp_ns=m.stamp_ns + k * period) for m in (back if k % 2 else there)]
    summaries = []
    for name, messages in (("short", patrol[: len(patrol) // 10]), ("long", patrol)):
        write(tmp_path / f"{name}.mcap", [lap[0], *messages])
        done = slam("replay", tmp_path / f"{name}.mcap", "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
        summaries.append(json.loads((tmp_path / name / "summary.json").read_text()))
    short, long = summaries
    assert long["scans"] == 10 * short["scans"]
    assert long["timing"]["cpu_s"] < 2 + 20 * short["timing"]["cpu_s"]
    assert long["peak_rss_mb"] < 2 * short["peak_rss_mb"]
