"""Ports that are missing, equal, swapped, or served by two simulators."""

import json
import threading
import time

import pytest
from slam.drivers.connection import DeviceEvent, Received, steady_utc
from slam.logs.recorder import Recorder

from slam.online.main_loop import LiveRun
from slam.online.robot_config import load_robot
from slam.online.run_online import run_online
from slam.online.simulated_devices import SimulatedDevices
from slam.runs.errors import ConfigError, RunError


def robot_toml(path, robot, laser):
    path.write_text(f"[robot]\nport='{robot}'\n[laser]\nport='{laser}'\n[mount]\nx=0.1\n")
    return path


def test_one_port_for_both_devices_is_refused_under_any_name(tmp_path):
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyACM0")
    for laser in ("ttyACM0", "by-id"):
        path = robot_toml(tmp_path / "robot.toml", tmp_path / "ttyACM0", tmp_path / laser)
        with pytest.raises(ConfigError, match="same port"):
            load_robot(path)
    path = robot_toml(tmp_path / "robot.toml", "tcp://a:1", "tcp://a:2")
    assert load_robot(path).laser.port == "tcp://a:2"


def test_two_simulators_do_not_share_a_folder(tmp_path):
    stop, said = threading.Event(), []
    devices = SimulatedDevices(folder=tmp_path / "ports")
    first = threading.Thread(target=devices.serve, args=(stop.is_set, said.append))
    first.start()
    try:
        end = time.monotonic() + 60.0
        while len(said) < 3 and time.monotonic() < end:
            time.sleep(0.02)
        with pytest.raises(RunError, match="another simulator"):
            devices.serve(lambda: True, said.append)
        assert (tmp_path / "ports" / "laser").is_symlink()
    finally:
        stop.set()
        first.join()
    devices.serve(lambda: True, said.append)  # now it is free


def test_a_recording_without_any_device_is_a_failure_that_says_why(tmp_path):
    path = robot_toml(tmp_path / "robot.toml", tmp_path / "no-robot", tmp_path / "no-laser")
    end = time.monotonic() + 0.5
    with pytest.raises(RunError, match=r"no device was ever connected; laser: .*no-laser does not"):
        run_online(load_robot(path), tmp_path / "run", stop=lambda: time.monotonic() > end,
                   record_only=True)  # fmt: skip
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["lost"] == {"p3dx: never connected": 1, "laser: never connected": 1}


@pytest.mark.parametrize("devices", [("laser", "p3dx"), ("laser",)])
def test_ports_that_may_be_swapped_are_hinted_at_once(tmp_path, devices):
    config = load_robot(robot_toml(tmp_path / "robot.toml", "a", "b"))
    with Recorder(tmp_path / "log.mcap") as recorder:
        live = LiveRun(config, recorder, steady_utc(), None)
        found = []
        for _ in range(2):
            for device in devices:
                name = {"laser": "Hokuyo", "p3dx": "Pioneer"}[device]
                event = DeviceEvent(1, device, "failed", f"no {name} answers on x. Is this ...")
                live.sequencer(Received(1, event))
            found += [text for text in live._device_events() if "swapped" in text]
    assert len(found) == (len(devices) == 2)
