"""`slam localise`: what it writes, and how it ends."""

import json
from dataclasses import replace

import numpy as np
import pytest
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import PoseEstimate
from slam.logs.trajectory import read_tum
from typer.testing import CliRunner

from slam.cli.app import app
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError
from slam.runs.localise import localise
from slam.runs.replay import replay

LASER = replace(LASERS["hokuyo-181"], rate_hz=4.0)


def write(path, messages):
    with LogWriter(path, {}) as log:
        for message in messages:
            log.write(message)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A RUN `map` of an office, a second drive there, and one in another building."""
    folder = tmp_path_factory.mktemp("localise")
    office = scenario("office", 3)
    write(folder / "first.mcap", simulate(office, LASER, seed=3))
    again = list(simulate(office, LASER, seed=4))
    write(folder / "again.mcap", [m for m in again if m.stamp_ns < again[0].stamp_ns + 25e9])
    other = list(simulate(scenario("clutter", 1), LASER, seed=4))
    write(folder / "other.mcap", [m for m in other if m.stamp_ns < other[0].stamp_ns + 10e9])
    replay(folder / "first.mcap", folder / "map", SlamConfig())
    return folder


def test_a_second_drive_is_localised_and_the_map_stays(folder, tmp_path):
    before = {p.name: p.read_bytes() for p in (folder / "map").iterdir()}
    out = tmp_path / "run"
    log = folder / "again.mcap"
    arguments = ["localise", str(log), "--map", str(folder / "map"), "--start", "0,0,0"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert {p.name: p.read_bytes() for p in (folder / "map").iterdir()} == before
    summary = json.loads((out / "summary.json").read_text())
    assert summary["lost_share"] == 0.0
    assert not summary["ended_lost"]
    assert summary["map"] == "map"
    trajectory = read_tum(out / "trajectory.tum")
    assert len(trajectory) == summary["scans"] == summary["localised_scans"]
    mapped = read_tum(folder / "map" / "trajectory.tum")  # the same way, with the same stamps
    rows = np.searchsorted(mapped.stamps_ns, trajectory.stamps_ns)
    off = np.hypot(*(trajectory.poses - mapped.poses[rows])[:, :2].T)
    assert np.median(off) < 0.02
    with open_log(out / "run.mcap") as opened:
        estimates = [m for m in opened.messages(("/pose",)) if isinstance(m, PoseEstimate)]
    assert len(estimates) == len(trajectory)
    assert len((out / "localisation.csv").read_text().splitlines()) == len(trajectory) + 1
    assert (out / "map.png").exists()
    assert (out / "map.yaml").exists()


def test_a_run_that_ends_lost_has_its_exit_code_and_says_why(folder, tmp_path):
    out = tmp_path / "run"
    arguments = ["localise", str(folder / "other.mcap"), "--map", str(folder / "map")]
    done = CliRunner().invoke(app, [*arguments, "--out", str(out)])
    assert done.exit_code == 3
    assert "lost at the end" in done.output
    summary = json.loads((out / "summary.json").read_text())
    assert summary["ended_lost"]
    assert summary["lost_share"] == 1.0
    assert summary["found_after_m"] is None
    assert len(read_tum(out / "trajectory.tum")) == 0


def test_equal_logs_give_equal_files(folder, tmp_path):
    log = folder / "other.mcap"
    for name in ("a", "b"):
        localise(log, folder / "map", tmp_path / name, SlamConfig())
    for file in ("trajectory.tum", "localisation.csv", "run.mcap"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_what_is_no_run_cannot_be_a_map(folder, tmp_path):
    with pytest.raises(RunError, match="no finished run"):
        localise(folder / "again.mcap", folder, tmp_path / "out", SlamConfig())
    assert not (tmp_path / "out").exists()
