"""`slam calibrate`, what it writes, and who takes it."""

import json
import math
import tomllib

import numpy as np
import pytest
from slam.drivers.simulators.laser import LASERS
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry
from slam.logs.parts import Recording
from typer.testing import CliRunner

from benchmarks.calibration import CASES, drive
from slam.cli.app import app
from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.online.robot_config import load_robot, load_slam
from slam.runs.errors import ConfigError, RunError
from slam.runs.mapper import Mapper
from slam.runs.offline import run_offline
from slam.tools.calibrate import calibrate_logs, described
from slam.tools.doctor.calibration_check import CalibrationCheck, known_calibration
from slam.tools.simulate import Robot, simulate_log

ROBOT = """
[robot]
port = "/dev/a"
[laser]
port = "/dev/b"
[mount]
x = 0.1
"""


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("calibrate") / "room.mcap"
    options = ("--laser-pose", "0.16,0.03,2deg", "--stated-pose", "0.16,0,0")
    options += ("--wheel-scales", "1.03,1.03", "--track-scale", "1.02", "--odometry-delay", "0.06")
    assert run("simulate", "calibration-room", "--out", path, *options).exit_code == 0
    return path


@pytest.fixture(scope="module")
def calibration(log):
    path = log.with_name("calibration.toml")
    done = run("calibrate", log, "--out", path)
    assert done.exit_code == 0, done.output
    assert "laser_y" in done.output
    assert "off by" in done.output
    return path


def test_what_is_wrong_is_in_the_file(calibration):
    table = tomllib.loads(calibration.read_text())["calibration"]
    assert table["laser_yaw_deg"] == pytest.approx(2.0, abs=0.1)
    assert table["laser_y"] == pytest.approx(0.03, abs=0.005)
    assert table["time_offset_s"] == pytest.approx(-0.06, abs=0.015)
    assert table["odometry_track_m"] == 0.357
    assert "# sigma 0.00" in calibration.read_text()


def test_replay_takes_it_and_the_odometry_fits_better(log, calibration, tmp_path):
    plain, corrected = tmp_path / "plain", tmp_path / "corrected"
    short = tmp_path / "short.mcap"
    with LogWriter(short, {}) as out:
        for k, message in enumerate(Recording(log).messages()):
            if k < 1500:
                out.write(message)
    assert run("replay", short, "--out", plain, "--processes", 1).exit_code == 0
    done = run("replay", short, "--out", corrected, "--processes", 1, "--calibration", calibration)
    assert done.exit_code == 0, done.output
    ends = [np.loadtxt(path / "odometry.tum")[-1, 1:3] for path in (plain, corrected)]
    truth = [np.loadtxt(path / "trajectory.tum")[-1, 1:3] for path in (plain, corrected)]
    errors = [float(np.hypot(*(a - b))) for a, b in zip(ends, truth, strict=True)]
    assert errors[1] < 0.7 * errors[0]  # the rest is random
    refused = run("report", corrected, "--frame", "laser")
    assert refused.exit_code == 1
    assert "leave --frame laser out" in str(refused.exception)


def test_robot_toml_takes_the_same_table(calibration, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(ROBOT + calibration.read_text())
    config = load_robot(path)
    assert config.slam.calibration.laser_y == pytest.approx(0.03, abs=0.005)
    assert load_slam(path).calibration == config.calibration
    again = load_robot(path, ["calibration.laser_y=0.5"])
    assert again.slam.calibration.laser_y == 0.5
    assert load_robot(path).mount.x == 0.1


def test_an_override_wins_over_the_file(calibration):
    config = load_slam(None, ["calibration.laser_x=0.3"], calibration)
    assert config.calibration.laser_x == 0.3
    assert config.calibration.laser_y == pytest.approx(0.03, abs=0.005)


def test_a_file_that_is_none_is_refused(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text("[calibration]\nlaser_z = 1\n")
    with pytest.raises(ConfigError, match="laser_z"):
        load_slam(None, [], path)
    with pytest.raises(ConfigError, match="cannot read"):
        load_slam(None, [], tmp_path / "none.toml")


def test_one_step_function_corrects_for_all():
    config = SlamConfig(calibration={"laser_x": 0.2, "translation_scale": 2.0})
    slam = Slam(config)
    assert slam.extrinsics.x == 0.2
    slam.step(LaserExtrinsics(0, 0.1, 0.05, 0.0))
    assert (slam.extrinsics.x, slam.extrinsics.y) == (0.2, 0.05)
    slam.step(WheelOdometry(1, 5.0, 0.0, 0.0))
    slam.step(WheelOdometry(2, 6.0, 0.0, 0.0))
    assert slam.odometry.x == pytest.approx(7.0)  # from where it began


def test_the_mapper_corrects_too(straight, sense):
    from slam.drivers.simulators.world import World

    room = World.from_polygon([(-3, -3), (9, -3), (9, 4), (2, 4), (2, 3), (-3, 3)])
    mapper = Mapper(config=SlamConfig(calibration={"translation_scale": 2.0}))
    x = 0.0
    for message in sense(room, straight(2.0)):
        if isinstance(message, WheelOdometry):
            x = 0.5 * message.x
        if isinstance(message, LaserScan):
            mapper.add(message.stamp_ns * 1e-9, message.ranges, message.angle_min,
                       message.angle_step, odometry=(x, 0.0, 0.0))  # fmt: skip
    assert mapper.pose[0] == pytest.approx(1.95, abs=0.02)


def test_a_run_is_the_same_by_a_calibration_or_by_corrected_messages():
    case = CASES[0]
    messages = list(drive(case, 2))[:1500]
    from slam.mapping.calibration import CalibrationConfig, Corrector

    known = CalibrationConfig(laser_y=0.03, translation_scale=1.03, time_offset_s=-0.04)
    corrector = Corrector(known)
    corrected = [corrector(message) for message in messages]
    by_config = run_offline(lambda: messages, SlamConfig(calibration=known))
    by_hand = run_offline(lambda: corrected, SlamConfig())
    assert np.array_equal(by_config.trajectory.poses, by_hand.trajectory.poses)


def test_the_doctor_names_what_disagrees(log):
    check = CalibrationCheck()
    for message in Recording(log).messages(("/scan", "/odom", "/tf")):
        check.feed(message)
    found = {one.code: one for one in check.findings()}
    assert found.keys() == {
        "calibration-laser-y", "calibration-laser-yaw-deg", "calibration-time-offset-s",
    } or found.keys() == {"calibration-laser-y", "calibration-laser-yaw-deg"}  # fmt: skip
    assert "laser_yaw_deg = 2.0" in found["calibration-laser-yaw-deg"].text
    assert {one.severity for one in found.values()} == {"note"}
    assert known_calibration(log) is None


def test_the_doctor_is_content_with_a_calibrated_robot(log, calibration, tmp_path):
    again = tmp_path / "online.mcap"
    table = tomllib.loads(calibration.read_text())["calibration"]
    with LogWriter(again, {}) as out:
        out.add_attachment(
            "robot.json", json.dumps({"calibration": table}).encode(), "application/json"
        )
    known = known_calibration(again)
    assert known.laser_y == table["laser_y"]
    check = CalibrationCheck(known)
    for message in Recording(log).messages(("/scan", "/odom", "/tf")):
        check.feed(message)
    assert list(check.findings()) == []


def test_logs_that_cannot_tell(tmp_path):
    path = tmp_path / "still.mcap"
    with LogWriter(path, {}) as out:
        for k in range(30):
            out.write(WheelOdometry(k * 100_000_000, 0.0, 0.0, 0.0))
    with pytest.raises(RunError, match="holds no scans"):
        calibrate_logs([path], SlamConfig())
    with LogWriter(tmp_path / "stands.mcap", {}) as out:
        for k in range(60):
            out.write(WheelOdometry(k * 100_000_000, 0.0, 0.0, 0.0))
            out.write(LaserScan(k * 100_000_000, -1.0, 0.1, np.full(20, 2.0, dtype=np.float32)))
    lines = list(described(calibrate_logs([tmp_path / "stands.mcap"], SlamConfig())))
    assert "all refused" in lines[1]


def test_words_of_the_command_line():
    robot = Robot.of("0.1,0,90deg", "", "1.03,0.97", 1.02, 0.04)
    assert robot.base_T_laser.theta() == pytest.approx(math.pi / 2)
    assert robot.wrong.stated is None
    for words in (
        ("x", "", "1,1"),
        ("0,0,0", "1", "1,1"),
        ("0,0,0", "", "1"),
        ("0,0,0", "", "0,1"),
    ):
        with pytest.raises(ValueError):  # noqa: PT011 - each has a text of its own
            Robot.of(*words, 1.0, 0.0)


def test_a_log_names_its_track_and_its_laser(tmp_path):
    path = tmp_path / "a.mcap"
    simulate_log("testbed-180cm", path, 0, "ld06", "typical")
    scans = list(Recording(path).messages(("/scan",)))
    assert {len(one.ranges) for one in scans} == {455, 456}
    assert scans[0].beam_period_s == pytest.approx(LASERS["ld06"].beam_period_s, rel=0.01)
