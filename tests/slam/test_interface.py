"""The Python interface: the same results as the commands, as arrays."""

import json
import subprocess
import sys

import numpy as np
import pytest
from slam.drivers.simulators.drive import paper_drive
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

import slam
from slam.mapping.config import SlamConfig
from slam.runs.errors import ConfigError, RunError

SETTINGS = {"keyframes.method": "constant", "keyframes.interval": 0.4}


@pytest.fixture(scope="module")
def messages():
    return list(paper_drive("180cm"))


@pytest.fixture(scope="module")
def log(messages, tmp_path_factory):
    path = tmp_path_factory.mktemp("interface") / "drive.mcap"
    with LogWriter(path, {}) as out:
        for message in messages:
            out.write(message)
    return path


@pytest.fixture(scope="module")
def run(log):
    return slam.replay(log, set=SETTINGS, threads=1)


def test_a_run_is_arrays_with_named_columns(run, messages):
    scans = [m for m in messages if isinstance(m, LaserScan)]
    assert run.trajectory["stamp_ns"].tolist() == [scan.stamp_ns for scan in scans]
    assert run.trajectory.dtype.names == ("stamp_ns", "x", "y", "theta")
    assert len(run.keyframes) == run.summary["keyframes"]
    assert run.covariances.shape == (len(scans), 3, 3)
    assert run.map.cells.max() == 100 or run.map.cells.max() > 90
    assert run.graph.size() == len(run.finished.result.edges) + 1
    assert run.graph.error(run.values) < 10.0 * len(run.keyframes)
    assert "keyframes" in repr(run)


def test_the_command_is_the_same_code(run, log, tmp_path):
    command = [sys.executable, "-m", "slam", "replay", str(log), "--out", str(tmp_path / "by-hand")]
    for key, value in SETTINGS.items():
        command += ["--set", f"{key}={value}"]
    subprocess.run(command, check=True, capture_output=True)
    saved = run.save(tmp_path / "saved")
    for name in ("trajectory.tum", "keyframes.tum", "graph.g2o", "map.pgm"):
        assert (saved / name).read_bytes() == (tmp_path / "by-hand" / name).read_bytes(), name
    counts = [json.loads((tmp_path / d / "summary.json").read_text())["matches"]
              for d in ("saved", "by-hand")]  # fmt: skip
    assert counts[0] == counts[1]
    with pytest.raises(RunError, match="exists already"):
        run.save(saved)


def test_a_run_is_evaluated_in_memory_as_from_its_directory(run, tmp_path):
    here = slam.evaluate(run)
    assert here.figures["ate_rmse_m"] < 0.02
    assert str(here).startswith("ATE 0.0")
    assert len(here.trans_errors) == here.figures["pairs"]
    there = slam.evaluate(run.save(tmp_path / "run"))
    assert there.figures["ate_rmse_m"] == pytest.approx(here.figures["ate_rmse_m"], abs=1e-9)
    assert there.figures["anees"] == pytest.approx(here.figures["anees"], rel=1e-6)


def test_a_mapper_needs_no_file(messages, run):
    mount = next(m for m in messages if isinstance(m, LaserExtrinsics))
    mapper = slam.Mapper((mount.x, mount.y, mount.theta), run.config)
    with pytest.raises(ValueError, match="no scan"):
        _ = mapper.pose
    odometry = {m.stamp_ns: m for m in messages if isinstance(m, WheelOdometry)}
    for scan in (m for m in messages if isinstance(m, LaserScan)):
        wheels = odometry[scan.stamp_ns]
        mapper.add(
            scan.stamp_ns * 1e-9, scan.ranges, scan.angle_min, scan.angle_step,
            odometry=(wheels.x, wheels.y, wheels.theta), range_max=scan.range_max,
        )  # fmt: skip
    end = run.trajectory[-1]
    assert mapper.pose == pytest.approx((end["x"], end["y"], end["theta"]), abs=0.02)
    assert np.linalg.eigvalsh(mapper.covariance).min() > 0.0
    assert len(mapper.trajectory()) == len(run.trajectory)
    assert mapper.occupancy().cells.shape[0] > 10
    whole = mapper.finish()
    np.testing.assert_allclose(whole.trajectory["x"], run.trajectory["x"], atol=1e-3)


def test_a_mapper_refuses_what_is_no_scan():
    mapper = slam.Mapper()
    with pytest.raises(ValueError, match="finite"):
        mapper.add(0.0, [1.0, 2.0], 0.0, 0.1, odometry=(np.nan, 0.0, 0.0))
    with pytest.raises(ValueError, match="ranges must be"):
        mapper.add(0.0, [[1.0]], 0.0, 0.1, odometry=(0.0, 0.0, 0.0))


def test_two_scans_give_the_motion_between_them(messages):
    first, *_, later = [m for m in messages if isinstance(m, LaserScan)][:40]
    a, b = (slam.Scan(s.ranges, s.angle_min, s.angle_step, s.range_max) for s in (first, later))
    found = slam.match(a, b, sigma=(0.3, 0.1, 0.1))
    assert found.converged
    assert found.inlier_fraction > 0.8
    assert found.pose[0] == pytest.approx(0.0, abs=0.3)
    assert found.covariance.shape == (3, 3)
    nothing = slam.match(a, slam.Scan(np.full(181, np.inf), a.angle_min, a.angle_step))
    assert not nothing.converged
    assert "usable beams" in nothing.reason


def test_mistakes_are_errors_with_a_line(log, tmp_path):
    with pytest.raises(ConfigError, match=r"unknown setting loops\.enable"):
        slam.replay(log, set={"loops.enable": False})
    with pytest.raises(ConfigError, match="interval"):
        slam.replay(log, config=SlamConfig(), set={"keyframes.interval": -1})
    with pytest.raises(AttributeError, match="no attribute"):
        _ = slam.nothing


def test_importing_slam_loads_nothing_heavy():
    code = "import sys, slam; print(sorted({'numpy', 'gtsam', 'numba'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert set(slam.__all__) <= set(dir(slam))
