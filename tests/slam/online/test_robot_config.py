import math
import tomllib
from pathlib import Path

import pytest
import tomli_w
from slam.drivers.pioneer_decoder import MODELS

from slam.online.robot_config import RobotConfig, load_robot, load_slam
from slam.runs.config_file import known_keys
from slam.runs.errors import ConfigError

PLAIN = """
[robot]
port = "/dev/a"
[laser]
port = "tcp://192.168.0.10:10940"
[mount]
x = 0.16
"""


@pytest.fixture
def load(tmp_path):
    def read(text=PLAIN, *overrides):
        path = tmp_path / "robot.toml"
        path.write_text(text)
        return load_robot(path, overrides)

    return read


def test_ports_and_mount_are_all_that_has_to_be_said(load):
    config = load()
    assert config.robot.driver().motion is None
    assert config.robot.driver().fast_baud == 38400
    assert config.laser.driver().cluster == 1
    assert config.mount.message(7).x == 0.16
    assert config.slam.keyframes.method == "sdp-pe"


def test_degrees_become_radians(load):
    config = load(PLAIN + "theta_deg = 180\n", "laser.from_deg=-90", "laser.to_deg=45")
    assert config.mount.message(0).theta == pytest.approx(math.pi)
    assert config.laser.driver().angle_min == pytest.approx(-0.5 * math.pi)
    assert config.laser.driver().angle_max == pytest.approx(0.25 * math.pi)


def test_pipeline_settings_have_a_section_and_a_short_name(load):
    config = load(
        PLAIN + "[slam.keyframes]\nmethod = 'constant'\n", "keyframes.interval=0.7",
        "slam.loops.enabled=false", "robot.fast_baud=0", "robot.model=p3dx",
    )  # fmt: skip
    assert (config.slam.keyframes.method, config.slam.keyframes.interval) == ("constant", 0.7)
    assert not config.slam.loops.enabled
    assert config.robot.driver().fast_baud is None
    assert config.robot.driver().model == MODELS["p3dx"]


@pytest.mark.parametrize(
    ("text", "override", "words"),
    [
        (
            "[robot]\nport = '/dev/a'\n[mount]\nx = 0\n",
            None,
            r"laser \(a section: write \[laser\], and port in it\) is missing",
        ),
        (PLAIN, "laser.skp=3", "did you mean laser.skip?"),
        (PLAIN, "robot.motion=true", "unknown setting robot.motion"),
        (PLAIN + "[slam.keyframs]\nmethod='constant'\n", None, "did you mean slam.keyframes"),
        (PLAIN, "robot.baud=1200", "ARCOS runs at 9600"),
        (PLAIN, "laser.from_deg=180", "less than to_deg"),
        (PLAIN, "mount.x=nan", "finite"),
        (PLAIN, "robot.port=", "robot.port"),
        ("[robot", None, "not valid TOML"),
    ],
)
def test_mistakes_are_named(load, text, override, words):
    with pytest.raises(ConfigError, match=words.replace("?", "[?]")):
        load(text, *filter(None, [override]))


def test_a_config_written_down_reads_as_it_was(load):
    port = "/dev/serial/by-id/\N{ROBOT FACE}"  # beyond 16 bits, where JSON has two escapes
    config = load(PLAIN, "keyframes.weights=[1, 2, 3, 4]", f'robot.port="{port}"')
    again = RobotConfig.model_validate(
        tomllib.loads(tomli_w.dumps(config.model_dump(exclude_none=True)))
    )
    assert again == config
    assert again.laser.reach_m == math.inf
    assert again.robot.port == port


def test_the_reference_names_every_setting():
    page = (Path(__file__).parents[3] / "docs" / "online.md").read_text()
    settings = [key for key in known_keys(RobotConfig) if "." in key and "slam." not in key]
    assert [key for key in settings if f"`{key}`" not in page] == []


def test_settings_of_a_run_are_not_taken_for_those_of_a_robot(tmp_path):
    """Both have sections `[laser]` and `[robot]`; a robot's name ports."""
    settings = tmp_path / "slam.toml"
    settings.write_text("[laser]\nrange_noise = 0.03\n\n[robot]\nmax_speed = 1.0\n")
    assert load_slam(settings).laser.range_noise == 0.03
    assert load_slam(settings).robot.max_speed == 1.0
