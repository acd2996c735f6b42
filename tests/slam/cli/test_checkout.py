"""`slam bench` in an installation without the source tree."""

import pytest

import slam
from slam.cli.checkout import load_benchmarks
from slam.runs.errors import RunError


def test_an_installed_package_says_where_the_benchmarks_are(tmp_path, monkeypatch):
    monkeypatch.setattr(slam, "__file__", str(tmp_path / "site-packages" / "slam" / "__init__.py"))
    with pytest.raises(RunError, match="get the source tree") as caught:
        load_benchmarks()
    assert "\n" not in str(caught.value)
