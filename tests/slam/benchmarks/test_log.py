"""The shape of `slam bench log`, on logs of a few seconds."""

import json

from benchmarks import log as bench_log
from benchmarks.log import bench_log as run
from benchmarks.run import BENCHMARKS, table


def test_rows_are_alike_and_nothing_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(bench_log, "QUICK_S", 2.0)
    found = run(True, tmp_path / "new" / "folder")
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    first, second = found["rows"]
    assert first.keys() == second.keys()
    assert [row["case"] for row in found["rows"]] == ["181 beams 10 Hz", "1081 beams 40 Hz"]
    assert all(row["write_per_s"] > 0 and row["mb_per_hour"] > 0 for row in found["rows"])
    assert found["meta"]["log_s"] == 2.0
    assert first["sync_ms_median"] > 0
    assert BENCHMARKS["log"].columns.keys() <= first.keys()
    assert table("log", found["rows"]).row_count == 2
    json.dumps(found, allow_nan=False)
