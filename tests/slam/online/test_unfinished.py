"""What stands in the folder of an online run while it lasts, and what others are told about it."""

import pytest
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import WheelOdometry
from slam.logs.recover import recover

from slam.mapping.config import SlamConfig
from slam.online.robot_config import load_slam
from slam.online.run_folder import RECORDING, online_run
from slam.runs.config_file import load_config
from slam.runs.errors import RunError


def told(out):
    """What a second run with this name is told."""
    with pytest.raises(RunError) as error, online_run(out, SlamConfig()):
        pass
    return str(error.value)


def test_a_live_recording_is_never_called_a_leftover(tmp_path):
    out = tmp_path / "run"
    with online_run(out, SlamConfig()) as folder:
        assert "recording there at this moment" in told(out)  # while kernels compile
        log = LogWriter(folder / RECORDING, {})
        log.write(WheelOdometry(1, 0.0, 0.0, 0.0))
        words = told(out)
        assert "recover" not in words
        assert "remove" not in words
        with pytest.raises(LogError, match="still being recorded"):
            recover(folder / f"{RECORDING}.partial", tmp_path / "saved.mcap")
        log.close()
    assert "exists already" in told(out)


def test_what_a_killed_run_has_left_is_named_file_by_file(tmp_path):
    folder = tmp_path / "run.recording"
    folder.mkdir()
    (folder / "recording_000.mcap").write_bytes(b"whole")
    log = LogWriter(folder / "recording_001.mcap", {})
    log.write(WheelOdometry(1, 0.0, 0.0, 0.0))
    log.sync()
    log.abandon()
    words = told(tmp_path / "run")
    assert f"slam recover {folder / 'recording_001.mcap.partial'}" in words
    assert "keep recording_000.mcap" in words
    saved = tmp_path / "saved.mcap"
    recover(folder / "recording_001.mcap.partial", saved)
    with open_log(saved) as log:
        assert log.counts()["/odom"] == 1


def test_two_recorders_do_not_share_a_file(tmp_path):
    log = LogWriter(tmp_path / "a.mcap", {})
    with pytest.raises(LogError, match="another program is recording"):
        LogWriter(tmp_path / "a.mcap", {})
    log.abandon()
    with pytest.raises(LogError, match="slam recover"):
        LogWriter(tmp_path / "a.mcap", {})


def test_the_settings_are_there_from_the_start_and_a_run_without_data_leaves_nothing(tmp_path):
    settings = load_config(None, ["loops.enabled=false"])
    with online_run(tmp_path / "run", settings) as folder:
        assert load_config(folder / "slam.toml") == settings
    assert not list(tmp_path.iterdir())


def test_replay_takes_the_part_of_a_robot_toml_that_is_its_own(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(
        "[robot]\nport='a'\n[laser]\nport='b'\n[mount]\nx=0.1\n[slam.loops]\nenabled=false\n"
    )
    assert load_slam(path, ["keyframes.method=constant"]) == load_config(
        None, ["loops.enabled=false", "keyframes.method=constant"]
    )
    path.write_text("[loops]\nenabled = false\n")
    assert load_slam(path, []) == load_config(path)
    assert load_slam(None, []) == load_config(None)
