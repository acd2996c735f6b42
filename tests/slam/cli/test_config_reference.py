"""The page of all settings is the one that the models give."""

from pathlib import Path

from slam.cli.config_reference import page
from slam.mapping.config import SlamConfig
from slam.runs.config_file import known_keys

PAGE = Path(__file__).parents[3] / "docs" / "configuration.md"


def test_the_page_in_docs_is_current():
    assert PAGE.read_text(encoding="utf-8") == page(), (
        "settings have changed: python -m slam.cli.config_reference > docs/configuration.md"
    )


def test_every_setting_has_a_row():
    text = page()
    for key in known_keys(SlamConfig):
        section, _, name = key.rpartition(".")
        assert f"| `{name}` |" in text or f"`[{key}" in text
        assert not section or f"## `[{section}]`" in text


def test_limits_and_choices_are_told():
    rows = {line.split("`")[1]: line for line in page().splitlines() if line.startswith("| `")}
    assert '`"sdp-pe"`, `"constant"`' in rows["method"] or '`"point_to_line"`' in rows["method"]
    assert "number >= 0, <= 1" in rows["good_pair_inlier_fraction"]
    assert "4 numbers" in rows["weights"]
    assert "`true`, `false`" in rows["reject_loops"]
