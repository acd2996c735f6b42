from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from slam.logs.errors import LogError
from slam.logs.mcap_file import MAGIC, walk
from slam.logs.mcap_log import LogWriter, open_log
from slam.logs.mcap_summary import read_summary
from slam.logs.messages import LaserScan, WheelOdometry
from slam.logs.recover import recover

from tests.logs.strategies import content


def write_in_chunks(path: Path, chunks: int = 6, per_chunk: int = 4) -> list[WheelOdometry]:
    """Write a log that syncs after every few messages, and return what is in it."""
    now = [0.0]
    messages = [WheelOdometry(k, float(k), 0.5, 0.25) for k in range(chunks * per_chunk)]
    with LogWriter(path, {"id": "7"}, clock=lambda: now[0], sync_period_s=1.0) as log:
        log.add_attachment("config.toml", b"a = 1", "application/toml")
        for k, message in enumerate(messages):
            now[0] += 1.0 if k % per_chunk == per_chunk - 1 else 0.0
            log.write(message)
    return messages


def test_a_sound_log_is_copied_whole(tmp_path: Path):
    messages = write_in_chunks(tmp_path / "a.mcap")
    report = recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert not report.lost
    assert not report.unclosed
    assert (report.messages, report.attachments) == ({"/odom": len(messages)}, 1)
    assert (report.first_ns, report.last_ns) == (0, len(messages) - 1)
    with open_log(tmp_path / "b.mcap") as log:
        assert list(log.messages()) == messages
        assert log.metadata()["run"]["id"] == "7"
        assert log.metadata()["recovered"]["source"] == "a.mcap"
        assert [a.data for a in log.attachments()] == [b"a = 1"]


def chunk_starts(path: Path) -> list[int]:
    with path.open("rb") as file:
        end = read_summary(file, path).data_end
        return [r.start for r in walk(file, len(MAGIC), end) if r.opcode == Opcode.CHUNK]


@pytest.mark.usefixtures("no_sync")
def test_cut_at_every_byte_of_the_last_two_chunks_the_ones_before_are_saved(tmp_path: Path):
    messages = write_in_chunks(tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    dense = chunk_starts(tmp_path / "a.mcap")[-2]
    saved_counts = []
    for length in [*range(260, dense, 37), *range(dense, len(whole))]:
        (tmp_path / "cut.mcap").write_bytes(whole[:length])
        report = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
        assert report.unclosed
        with open_log(tmp_path / "out.mcap") as log:
            saved = list(log.messages())
            assert not log.skipped
        assert saved == messages[: len(saved)]
        assert len(saved) % 4 == 0
        saved_counts.append(len(saved))
        if length >= dense:
            assert len(saved) >= len(messages) - 8
    assert saved_counts == sorted(saved_counts)
    assert saved_counts[-1] == len(messages)


def test_cut_before_anything_of_substance_there_is_nothing_to_save(tmp_path: Path):
    write_in_chunks(tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    for length in range(8, 60):
        (tmp_path / "cut.mcap").write_bytes(whole[:length])
        with pytest.raises(LogError, match="nothing that is intact"):
            recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert not list(tmp_path.glob("out*"))


def test_what_was_lost_is_described(tmp_path: Path):
    write_in_chunks(tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    last_chunk = chunk_starts(tmp_path / "a.mcap")[-1]
    (tmp_path / "cut.mcap").write_bytes(whole[: last_chunk + 60])
    report = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert report.lost
    assert report.lost_bytes == 60
    (problem,) = report.problems
    assert "from 20 to 23 ns" in problem
    assert "more bytes than the file has" in problem


@pytest.mark.usefixtures("no_sync")
@given(st.data())
@settings(
    max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_flipped_bytes_lose_chunks_but_never_invent_messages(tmp_path: Path, data):
    messages = write_in_chunks(tmp_path / "a.mcap")
    damaged = bytearray((tmp_path / "a.mcap").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(8, len(damaged) - 1))
        damaged[at] ^= data.draw(st.integers(1, 255))
    (tmp_path / "bad.mcap").write_bytes(damaged)
    try:
        with open_log(tmp_path / "bad.mcap") as log:
            read = list(log.messages())
            list(log.attachments())
            log.counts()
            assert len(read) == len(messages) or log.skipped
            assert all(message in messages for message in read)
    except LogError:
        pass
    try:
        report = recover(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    except LogError:
        return
    with LogOrNone(tmp_path / "out.mcap") as log:
        if log is not None:
            saved = list(log.messages())
            assert all(message in messages for message in saved)
            assert len(saved) == len(messages) or report.lost or report.unclosed


class LogOrNone:
    """A recovered log may have lost its own channels, or carry a damaged version number."""

    def __init__(self, path: Path) -> None:
        try:
            self.log = open_log(path)
        except LogError:
            self.log = None

    def __enter__(self):
        return self.log

    def __exit__(self, *_):
        if self.log is not None:
            self.log.close()


def test_recovering_needs_a_log_and_another_name(tmp_path: Path):
    write_in_chunks(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="another file"):
        recover(tmp_path / "a.mcap", tmp_path / "a.mcap")
    (tmp_path / "text").write_text("hello, this is no log")
    with pytest.raises(LogError, match="not an MCAP"):
        recover(tmp_path / "text", tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_an_unfinished_recording_is_recovered_under_the_name_it_should_have_had(tmp_path: Path):
    log = LogWriter(tmp_path / "a.mcap")
    log.write(WheelOdometry(1, 0.0, 0.0, 0.0))
    log.sync()
    log.abandon()
    whole = (tmp_path / "a.mcap.partial").read_bytes()
    report = recover(tmp_path / "a.mcap.partial", tmp_path / "a.mcap")
    assert report.messages == {"/odom": 1}
    assert (tmp_path / "a.mcap.partial").read_bytes() == whole
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "a.mcap.partial"]


def random_scans(n: int) -> list[LaserScan]:
    """Return scans that hardly compress: each chunk has several blocks."""
    rng = np.random.default_rng(7)
    return [LaserScan(k, 0.0, 0.01, rng.random(1081).astype(np.float32)) for k in range(n)]


def test_of_a_large_chunk_that_is_cut_the_whole_blocks_are_saved(tmp_path: Path):
    scans = random_scans(29)  # 250 kB: one chunk of two blocks
    with LogWriter(tmp_path / "a.mcap") as log:
        for scan in scans:
            log.write(scan)
    whole = (tmp_path / "a.mcap").read_bytes()
    (start,) = chunk_starts(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        end = next(walk(file, start, len(whole))).end
    (tmp_path / "cut.mcap").write_bytes(whole[: end - 100])
    report = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert report.lost
    assert 10 <= report.unchecked < len(scans)
    assert "saved, unchecked" in report.problems[0]
    with open_log(tmp_path / "out.mcap") as log:
        saved = list(log.messages())
    assert [content(a) for a in saved] == [content(b) for b in scans[: report.unchecked]]
