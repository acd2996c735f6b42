"""Settings: refused with a hint, frozen once made, the same however they are written."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from slam.mapping.config import SlamConfig
from slam.runs.config_file import known_keys, load_config, nearest
from slam.runs.errors import ConfigError

LEAVES = [
    key for key in known_keys(SlamConfig)
    if not any(other.startswith(f"{key}.") for other in known_keys(SlamConfig))
]  # fmt: skip


def value_of(config, key):
    for name in key.split("."):
        config = getattr(config, name)
    return config


def as_toml(value):
    if isinstance(value, bool):
        return str(value).lower()
    return repr(list(value)) if isinstance(value, tuple) else repr(value)


def test_without_a_file_the_defaults_hold():
    assert load_config(None) == SlamConfig()


@pytest.mark.parametrize("key", LEAVES)
def test_every_setting_can_be_named_on_the_command_line(key):
    default = value_of(SlamConfig(), key)
    if default is None:  # what is left out has no word of its own
        assert value_of(load_config(None, [f"{key}=0.5"]), key) == 0.5
    else:
        assert load_config(None, [f"{key}={as_toml(default)}"]) == SlamConfig()
    with pytest.raises(ConfigError, match=re.escape(key)):
        load_config(None, [f"{key}={{}}"])


@given(st.sampled_from(LEAVES), st.integers(0, 100), st.sampled_from("abcxyz"))
def test_a_typo_is_answered_with_the_nearest_name(key, at, letter):
    section, _, name = key.rpartition(".")
    typo = name[: at % len(name)] + letter + name[at % len(name) :]
    if name == typo or f"{section}.{typo}".strip(".") in known_keys(SlamConfig):
        return
    with pytest.raises(ConfigError, match=r"unknown setting .*did you mean") as caught:
        load_config(None, [f"{section}.{typo}=1".lstrip(".")])
    suggested = str(caught.value).rpartition("did you mean ")[2].rstrip("?")
    assert suggested in known_keys(SlamConfig)


def test_the_nearest_name_is_the_one_meant():
    with pytest.raises(ConfigError, match=r"did you mean keyframes\.interval\?"):
        load_config(None, ["keyframes.intervall=1"])
    with pytest.raises(ConfigError, match=r"did you mean keyframes\?"):
        load_config(None, ["keyframe.interval=1"])
    assert nearest("qqqqqq", ["keyframes"]) == ""


def test_a_file_and_overrides_on_top_of_it(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text('[keyframes]\nmethod = "constant"\ninterval = 0.4\n\n[loops]\nplaces = 2\n')
    config = load_config(file, ["keyframes.interval=0.6", "loops.enabled=false"])
    assert (config.keyframes.method, config.keyframes.interval) == ("constant", 0.6)
    assert (config.loops.places, config.loops.enabled) == (2, False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[keyframes]\nintervall = 1\n", r"unknown setting keyframes\.intervall; did you mean"),
        ("[keyframes]\ninterval = -1\n", r"keyframes\.interval: .* greater than 0 \(got -1\)"),
        ('[keyframes]\nmethod = "sdp"\n', r"keyframes\.method: .*'sdp-pe'.*\(got 'sdp'\)"),
        ("[keyframes]\nweights = [1, 2]\n", r"keyframes\.weights"),
        ("keyframes = 3\n", r"keyframes is a section: set keyframes\.NAME"),
        ("[keyframes]\nmin_interval = 9\n", "min_interval must not exceed max_interval$"),
        ("[laser]\nrange_noise = nan\n", r"laser\.range_noise: .*nan"),
        ("[keyframes\n", "not valid TOML"),
    ],
)
def test_a_mistake_in_the_file_is_named_with_the_file(tmp_path, text, message):
    file = tmp_path / "robot.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(file, ["loops.enabled=false"])
    assert str(caught.value).startswith(f"{file}: ")
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        load_config(tmp_path / "missing.toml")
    with pytest.raises(ConfigError, match="Is a directory"):
        load_config(tmp_path)
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b"# caf\xe9\n")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_config(latin)


@pytest.mark.parametrize("override", ["keyframes", "=3", "", "keyframes.interval", " =1"])
def test_an_override_needs_a_name_and_a_value(override):
    with pytest.raises(ConfigError, match=r"expected section\.key=value"):
        load_config(None, [override])


def test_an_override_below_a_value_is_refused():
    with pytest.raises(ConfigError, match="interval is not a section"):
        load_config(None, ["keyframes.interval=2", "keyframes.interval.x=1"])


def test_a_configuration_cannot_be_changed():
    config = SlamConfig()
    with pytest.raises(ValidationError, match="frozen"):
        config.keyframes.interval = 2.0


def test_the_hash_follows_the_meaning_not_the_writing(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text("[loops]\nplaces = 2\n[keyframes]\ninterval = 4e-1\n")
    overrides = ["keyframes.interval=0.4", "loops.places=2"]
    assert load_config(file).sha256() == load_config(None, overrides).sha256()
    assert load_config(file).sha256() != SlamConfig().sha256()


def test_the_effective_configuration_makes_itself_again():
    config = load_config(None, ["keyframes.weights=[1, 2, 3, 4]", "loops.every_m=2.5"])
    assert SlamConfig.model_validate_json(config.model_dump_json()) == config


def models(model=SlamConfig):
    yield model
    for field in model.model_fields.values():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from models(field.annotation)


def test_every_setting_says_what_it_is_and_what_it_refuses():
    for model in models():
        assert model.model_config.get("frozen"), model
        assert model.model_config.get("extra") == "forbid", model
        for name, field in model.model_fields.items():
            section = isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
            assert section or field.description, f"{model.__name__}.{name} has no description"
