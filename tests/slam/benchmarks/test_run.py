"""The registry of `slam bench`: every entry fits its function, every wrong call has one line."""

import importlib
import inspect

import pytest

from benchmarks.run import BENCHMARKS, described, run_bench
from slam.runs.errors import RunError


@pytest.mark.parametrize("name", BENCHMARKS)
def test_an_entry_names_a_function_and_its_arguments(name):
    benchmark = BENCHMARKS[name]
    module, _, function = benchmark.function.partition(":")
    found = inspect.signature(getattr(importlib.import_module(module), function)).parameters
    assert set(benchmark.takes.split()) == found.keys()
    assert not benchmark.data or "data" in found


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("outlier", {}, "did you mean outliers"),
        ("outliers", {}, "--data DIR, where DIR holds `graphs/`"),
        ("log", {"workers": 2}, "cannot use workers, only benchmark, calibration, pareto"),
    ],
)
def test_a_wrong_call_is_told_before_anything_is_measured(tmp_path, name, options, message):
    with pytest.raises(RunError, match=message) as caught:
        run_bench(name, tmp_path / "out", None, True, print, **options)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_data_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RunError, match="no such folder"):
        run_bench("outliers", tmp_path, tmp_path / "nowhere", True, print)


def test_the_list_has_a_line_for_each():
    assert [line.split()[0] for line in described()] == list(BENCHMARKS)
