"""Which logs `slam bench benchmark` takes, and how it says that there are none."""

import pytest

from benchmarks.benchmark import bench_benchmark, logs_in
from benchmarks.run import BENCHMARKS, table
from slam.runs.errors import RunError


def test_logs_with_relations_are_taken_whatever_their_names(tmp_path):
    for name in ("zoo.clf.gz", "zoo.relations", "attic.clf.gz", "attic.relations", "bare.clf.gz"):
        (tmp_path / name).touch()
    assert logs_in(tmp_path) == ["attic", "zoo"]


def test_a_folder_without_logs_is_named(tmp_path):
    with pytest.raises(RunError, match="no NAME"):
        bench_benchmark(tmp_path, False, lambda text: None)


def test_a_log_without_published_figures_has_a_dash():
    row = dict.fromkeys(BENCHMARKS["benchmark"].columns, 1.0) | {"published_trans_mean_m": None}
    cells = [next(iter(column.cells)) for column in table("benchmark", [row]).columns]
    assert cells.count("-") == 1
