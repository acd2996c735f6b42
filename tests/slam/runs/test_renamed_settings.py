"""Settings under their old names work for one version, with a warning that names the new one."""

import pytest

from slam.mapping.config import SlamConfig
from slam.runs.config_file import known_keys, load_config
from slam.runs.errors import ConfigError
from slam.runs.renamed_settings import FIXED, RENAMED, OldSettingWarning

OLD = """
[scan]
range_noise = 0.03
unbend = true
[matcher]
range_noise = 0.03
[tracking]
references = 4
good_quality = 0.5
[thinning]
enough = 5
[localise]
refine_passes = 2
"""


def test_a_file_of_the_version_before_is_read(tmp_path):
    file = tmp_path / "old.toml"
    file.write_text(OLD)
    with pytest.warns(OldSettingWarning) as warned:
        config = load_config(file)
    assert (config.laser.range_noise, config.scan.range_noise) == (0.03, 0.03)
    assert config.matcher.range_noise == 0.03
    assert config.scan.deskew
    assert config.registration.references == 4
    assert config.registration.good_inlier_fraction == 0.5
    assert config.pruning.min_redundancy == 5
    said = [str(one.message) for one in warned]
    assert f"{file}: scan.unbend is now called scan.deskew" in said
    assert f"{file}: localise.refine_passes is no longer a setting and is left out" in said


def test_an_override_under_its_old_name():
    with pytest.warns(OldSettingWarning, match=r"thinning\.enough is now called pruning\.min"):
        config = load_config(None, ["thinning.enough=0", "pruning.within_m=0.7"])
    assert (config.pruning.min_redundancy, config.pruning.within_m) == (0, 0.7)


@pytest.mark.filterwarnings("ignore::slam.runs.renamed_settings.OldSettingWarning")
def test_two_old_names_of_one_setting_must_agree(tmp_path):
    file = tmp_path / "old.toml"
    file.write_text("[scan]\nrange_noise = 0.01\n[matcher]\nrange_noise = 0.02\n")
    with pytest.raises(ConfigError, match="contradict each other"):
        load_config(file)


def test_every_new_name_exists_and_no_old_one_does():
    known = known_keys(SlamConfig)
    assert set(RENAMED.values()) <= set(known)
    assert not set(known) & (RENAMED.keys() | FIXED)


def test_the_laser_is_described_in_one_place():
    with pytest.raises(ValueError, match=r"set laser\.range_noise"):
        SlamConfig(scan={"range_noise": 0.05})
