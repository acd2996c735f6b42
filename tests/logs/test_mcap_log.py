from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.writer import Writer
from slam.logs.errors import LogError, NewerSchema, TruncatedLog
from slam.logs.mcap_log import SCHEMA_VERSION, LogWriter, open_log
from slam.logs.messages import WheelOdometry


def odometry(n: int) -> list[WheelOdometry]:
    return [WheelOdometry(k * 100_000_000, float(k), 0.0, 0.0) for k in range(n)]


def write(path: Path, n: int = 10) -> Path:
    with LogWriter(path, {"robot": "p3dx"}) as log:
        for message in odometry(n):
            log.write(message)
    return path


def test_metadata_and_attachments_come_back(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path, {"robot": "p3dx"}) as log:
        log.write(odometry(1)[0])
        log.add_metadata("clock", {"offset": "1"})
        log.add_attachment("config.toml", b"x = 1\n", "application/toml")
        log.add_metadata("clock", {"drift": "2"})
    with open_log(path) as log:
        assert log.metadata() == {
            "run": {"robot": "p3dx", "schema_version": str(SCHEMA_VERSION)},
            "clock": {"offset": "1", "drift": "2"},
        }
        (attached,) = log.attachments()
        assert (attached.name, attached.data) == ("config.toml", b"x = 1\n")
        assert list(log.messages()) == odometry(1)


def test_equal_input_gives_equal_bytes(tmp_path: Path):
    assert write(tmp_path / "a.mcap").read_bytes() == write(tmp_path / "b.mcap").read_bytes()


def test_the_name_appears_only_when_the_log_is_complete(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        log.write(odometry(1)[0])
        assert [p.name for p in tmp_path.iterdir()] == ["a.mcap.partial"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def interrupted_recording(path: Path) -> None:
    with LogWriter(path) as log:
        log.write(odometry(1)[0])
        raise KeyboardInterrupt


def test_an_exception_leaves_the_partial_file_and_it_is_not_overwritten(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with pytest.raises(KeyboardInterrupt):
        interrupted_recording(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap.partial"]
    with pytest.raises(LogError, match="slam recover"):
        LogWriter(path)


def test_a_file_that_can_be_made_again_is_not_kept_unfinished(tmp_path: Path):
    with pytest.raises(ZeroDivisionError), LogWriter(tmp_path / "a.mcap", keep_partial=False):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_data_reaches_the_file_within_the_sync_period(tmp_path: Path):
    now = [0.0]
    sizes = []
    path = tmp_path / "a.mcap"
    with LogWriter(path, clock=lambda: now[0], sync_period_s=0.5) as log:
        for k, message in enumerate(odometry(30)):
            now[0] = 0.1 * k
            log.write(message)
            sizes.append(path.with_name("a.mcap.partial").stat().st_size)
        grew_at = [k for k in range(1, 30) if sizes[k] > sizes[k - 1]]
        now[0] += 0.6
        log.tick()
        assert path.with_name("a.mcap.partial").stat().st_size > sizes[-1]
    assert all(b - a <= 5 for a, b in pairwise(grew_at))
    assert len(grew_at) >= 5


def test_a_closed_log_takes_no_more(tmp_path: Path):
    log = LogWriter(tmp_path / "a.mcap")
    log.close()
    log.close()
    with pytest.raises(LogError, match="closed"):
        log.write(odometry(1)[0])


@pytest.mark.parametrize(
    "name", ["../x", "a/b", "a\\b", "", ".hidden", "x\x1b[2J", "C:x", 99 * "n"]
)
def test_attachment_names_are_plain(tmp_path: Path, name: str):
    with LogWriter(tmp_path / "a.mcap") as log, pytest.raises(LogError, match="plain"):
        log.add_attachment(name, b"", "text/plain")


def test_a_full_disk_is_one_clear_line_and_leaves_a_recoverable_file(tmp_path: Path):
    if not os.path.exists("/dev/full"):
        pytest.skip("/dev/full is not there to stand for a full disk")
    log = LogWriter(tmp_path / "a.mcap")
    real = log._file.stream.fileno()
    log.write(odometry(1)[0])
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, real)  # from here on the disk is full
    os.close(full)
    with pytest.raises(LogError, match="No space left on device"):
        log.sync()
    with pytest.raises(LogError, match="closed"):
        log.write(odometry(1)[0])


def test_what_is_no_log_is_one_clear_line(tmp_path: Path):
    empty, text, bag = tmp_path / "empty", tmp_path / "text", tmp_path / "bag.mcap"
    empty.touch()
    text.write_text("PARAM robot_width 0.41 nohost 0\n")
    with bag.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", b"")
        channel = writer.register_channel("/scan\x1b[2J", "cdr", schema)
        writer.add_message(channel, 0, b"", 0)
        writer.finish()
    for path, said in [
        (tmp_path / "nowhere", "no such file"),
        (tmp_path, "folder"),
        (empty, "empty"),
        (text, "not an MCAP log"),
        (bag, r"/scan\\x1b\[2J \(sensor_msgs/msg/LaserScan\)"),
    ]:
        with pytest.raises(LogError, match=said) as caught:
            open_log(path)
        line = str(caught.value)
        assert line.isprintable()
        assert line.startswith(str(path))


def test_a_file_without_read_permission(tmp_path: Path):
    path = write(tmp_path / "a.mcap")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(LogError, match="Permission denied"):
        open_log(path)


def test_a_folder_that_cannot_be_written(tmp_path: Path):
    with pytest.raises(LogError, match="cannot be written"):
        LogWriter(tmp_path / "nowhere" / "a.mcap")
    with pytest.raises(LogError, match="is a folder"):
        LogWriter(tmp_path)


def test_a_newer_schema_is_refused(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        log.add_metadata("run", {"schema_version": str(SCHEMA_VERSION + 1)})
    with pytest.raises(NewerSchema, match="upgrade"):
        open_log(path)


def test_a_schema_version_that_is_no_number_is_refused(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        log.add_metadata("run", {"schema_version": "1" * 5000})
    with pytest.raises(LogError, match="not a number"):
        open_log(path)


def test_a_file_cut_at_any_byte_says_so(tmp_path: Path):
    whole = write(tmp_path / "whole.mcap", 3).read_bytes()
    path = tmp_path / "cut.mcap"
    for length in [*range(8, len(whole) - 300, 9), *range(len(whole) - 300, len(whole))]:
        path.write_bytes(whole[:length])
        with pytest.raises(TruncatedLog, match=r"slam recover .*cut\.mcap"):
            open_log(path)


def test_two_readings_at_once_do_not_disturb_each_other(tmp_path: Path):
    with open_log(write(tmp_path / "a.mcap")) as log:
        pairs = list(zip(log.messages(), log.messages(), strict=True))
    assert [a for a, _ in pairs] == [b for _, b in pairs] == odometry(10)
