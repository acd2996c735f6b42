import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from slam.drivers.probe import ProbeReport
from typer.testing import CliRunner

from slam.cli.app import app
from slam.online.robot_config import load_robot
from slam.online.setup_files import Mount, lasting_name, robot_toml, systemd_unit, udev_rules
from slam.runs.errors import ConfigError, RunError

PORTS = {"p3dx": "/dev/serial/by-id/usb-adapter", "laser": "tcp://192.168.0.10:10940"}


def test_the_file_is_a_robot_toml(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(robot_toml(PORTS, Mount(0.16, theta_deg=1.5)))
    config = load_robot(path)
    assert (config.robot.port, config.laser.port) == (PORTS["p3dx"], PORTS["laser"])
    assert (config.mount.x, config.mount.theta_deg) == (0.16, 1.5)


@pytest.mark.parametrize(
    ("ports", "mount", "missing"), [(PORTS, Mount(), r"mount\.x"), ({}, Mount(0.1), r"robot\.port")]
)
def test_what_is_not_known_is_asked_for_by_name(tmp_path, ports, mount, missing):
    path = tmp_path / "robot.toml"
    path.write_text(robot_toml(ports, mount))
    with pytest.raises(ConfigError, match=missing):
        load_robot(path)


def test_a_port_gets_the_name_that_lasts(tmp_path):
    (tmp_path / "ttyACM3").touch()
    (tmp_path / "usb-Hokuyo").symlink_to(tmp_path / "ttyACM3")
    found = lasting_name(str(tmp_path / "ttyACM3"), str(tmp_path / "usb-*"))
    assert found == str(tmp_path / "usb-Hokuyo")
    assert lasting_name("/dev/ttyX", str(tmp_path / "usb-*")) == "/dev/ttyX"
    assert lasting_name("tcp://a:1") == "tcp://a:1"


def usb(device, serial=None, location=None):
    return SimpleNamespace(
        device=device, vid=0x15D1, pid=0, serial_number=serial, location=location
    )


def test_rules_name_devices_by_their_number_or_else_by_their_socket():
    reports = [ProbeReport("/dev/a", "laser", "a laser"), ProbeReport("/dev/b", "p3dx", "a robot"),
               ProbeReport("/dev/c", None, "nothing")]  # fmt: skip
    text = udev_rules(reports, [usb("/dev/a", "H1"), usb("/dev/b", None, "1-1.2"), usb("/dev/c")])
    laser, robot = text.splitlines()[1:]
    assert 'ATTRS{idVendor}=="15d1", ATTRS{idProduct}=="0000", ATTRS{serial}=="H1"' in laser
    assert 'SYMLINK+="hokuyo"' in laser
    assert 'KERNELS=="1-1.2"' in robot
    assert 'SYMLINK+="p3dx"' in robot
    with pytest.raises(RunError, match="USB"):
        udev_rules(reports[2:], [usb("/dev/c")])
    with pytest.raises(RunError, match="no port should have"):
        udev_rules(reports, [usb("/dev/a", 'H1", RUN+="/bin/evil')])


def test_the_unit_is_one_that_systemd_takes(tmp_path):
    program = Path("/bin/true")
    text = systemd_unit(program, tmp_path / "robot.toml", tmp_path, "root")
    assert f"--out {tmp_path}/$(date +%%Y%%m%%dT%%H%%M%%S)'" in text
    (tmp_path / "slam.service").write_text(text)
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    done = subprocess.run(
        ["systemd-analyze", "verify", str(tmp_path / "slam.service")],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "slam.service:" not in done.stderr, done.stderr
    with pytest.raises(RunError, match="letters, digits"):
        systemd_unit(program, tmp_path / "my robot.toml", tmp_path, "root")


def test_init_writes_what_it_knows_and_replaces_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["init", str(tmp_path / "nothing"), "--mount-x", "0.2", "--systemd", "slam.service"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1  # neither device was found
    assert "still lacks the port of the p3dx, the port of the laser" in done.output
    assert "x = 0.2" in (tmp_path / "robot.toml").read_text()
    again = CliRunner().invoke(app, words)
    assert isinstance(again.exception, RunError)
    assert "exists already" in str(again.exception)
