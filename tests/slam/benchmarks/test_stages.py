"""Where the time of a replay goes: the parts make up the whole."""

import json

import pytest

from benchmarks.run import BENCHMARKS, table
from benchmarks.stage_times import STAGES, measure
from slam.tools.simulate import simulate_log


def test_stages_and_the_rest_make_up_the_whole(tmp_path, capsys):
    log = tmp_path / "corridor.mcap"
    simulate_log("corridor", log, 0, "hokuyo-181", "typical")
    measure(str(log), str(tmp_path))
    row = {"log": "corridor", **json.loads(capsys.readouterr().out)}
    parts = [row[f"{stage}_s"] for stage in STAGES]
    assert sum(parts) + row["start_s"] + row["rest_s"] == pytest.approx(row["cpu_s"])
    assert all(part >= 0.0 for part in parts)
    assert row["rest_s"] > 0.0
    assert BENCHMARKS["stages"].columns.keys() <= row.keys()
    assert table("stages", [row]).row_count == 1
    assert [path.name for path in tmp_path.iterdir()] == ["corridor.mcap"]
