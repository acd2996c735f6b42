"""Campaigns that are stopped and gone on with."""

import pytest

from benchmarks.kept_runs import KeptRuns
from slam.runs.errors import RunError


def test_what_was_made_is_not_made_again(tmp_path):
    path, made = tmp_path / "new" / "runs.jsonl", []

    def make(name):
        made.append(name)
        return {"name": name, "wrong": []}

    for names in ("ab", "abc"):
        kept = KeptRuns(path)
        rows = [kept.made(name, lambda n=name: make(n)) for name in names]
    assert made == ["a", "b", "c"]
    assert [row["name"] for row in rows] == ["a", "b", "c"]


def test_rows_are_found_again_under_their_names(tmp_path):
    path = tmp_path / "runs.jsonl"
    KeptRuns(path).add("clutter, seed 1", {"ate_m": 0.01})
    kept = KeptRuns(path)
    assert "clutter, seed 1" in kept
    assert "clutter, seed 2" not in kept
    assert kept["clutter, seed 1"] == {"ate_m": 0.01}


def test_a_cut_line_and_another_program_do_not_count(tmp_path):
    path = tmp_path / "runs.jsonl"
    KeptRuns(path).made("a", lambda: {"x": 1})
    line = path.read_text()
    path.write_text(line.replace('"made_by": "', '"made_by": "older ') + line[: len(line) // 2])
    assert KeptRuns(path).made("a", lambda: {"x": 2}) == {"x": 2}
    assert KeptRuns(path).made("a", dict) == {"x": 2}


def test_a_disk_without_room_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="cannot be written"):
        KeptRuns(tmp_path / "file" / "runs.jsonl").made("a", dict)
