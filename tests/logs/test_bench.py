from __future__ import annotations

from pathlib import Path

from benchmarks.log_speed import SENSORS, Sensors, _in_fresh_process, _write, drive, log_rows


def test_a_small_table(tmp_path: Path):
    rows = log_rows(tmp_path, seconds=2.0)
    assert [row["case"] for row in rows] == [*(s.name for s in SENSORS), "fsync"]
    for row in rows[:-1]:
        scans = 20 if "181" in row["case"] else 80
        assert row["messages"] == 2 * scans + 2 * 20  # each with its raw bytes
        assert row["write_x_realtime"] > 10
        assert 0 < row["mb_per_hour_closed"] <= row["mb_per_hour"] * 1.05
    assert rows[-1]["sync_ms_median"] > 0
    assert list(tmp_path.iterdir()) == []


def test_reading_an_hour_takes_no_more_memory_than_reading_a_minute(tmp_path: Path):
    sensors = Sensors("hour", 181, 10.0)
    cycle = list(drive(sensors, 10.0))
    peaks = []
    for seconds in (60.0, 3600.0):
        path = tmp_path / f"{seconds}.mcap"
        _write(path, cycle, seconds)
        peaks.append(_in_fresh_process(path)[1])
    assert peaks[1] < peaks[0] + 15
