from __future__ import annotations

from pathlib import Path

import pytest
from slam.logs.errors import LogError
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.messages import WheelOdometry
from slam.logs.recompress import recompress


def write_small_chunks(path: Path, n: int = 400) -> None:
    now = [0.0]
    with LogWriter(path, {"id": "1"}, clock=lambda: now[0], sync_period_s=0.5) as log:
        log.add_attachment("config.toml", b"a = 1", "application/toml")
        for k in range(n):
            now[0] += 0.1
            log.write(WheelOdometry(k, 0.1 * k, 0.0, 0.0), receipt_ns=k + 5)


def everything(path: Path):
    with open_log(path) as log:
        read = list(log.receipts())
        assert not log.skipped
        return read, log.metadata(), list(log.attachments())


def test_nothing_changes_but_the_size(tmp_path: Path):
    path = tmp_path / "a.mcap"
    write_small_chunks(path)
    before = everything(path)
    result = recompress(path)
    assert everything(path) == before
    assert result.bytes_after == path.stat().st_size < 0.6 * result.bytes_before
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_a_damaged_log_is_left_as_it_is(tmp_path: Path):
    path = tmp_path / "a.mcap"
    write_small_chunks(path)
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 3] ^= 0xFF
    path.write_bytes(damaged)
    with pytest.raises(LogError):
        recompress(path)
    assert path.read_bytes() == damaged
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_what_is_not_there_is_one_clear_line(tmp_path: Path):
    with pytest.raises(LogError, match="no such file"):
        recompress(tmp_path / "nowhere.mcap")
