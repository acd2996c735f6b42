from __future__ import annotations

import resource
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import LogError
from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, RawBytes, WheelOdometry
from slam.logs.part_writer import PartWriter
from slam.logs.recorder import Recorder
from slam.logs.recording import RecorderConfig
from slam.logs.recover import recover


def odometry(k: int) -> WheelOdometry:
    return WheelOdometry(k * 1_000_000, float(k), 0.0, 0.0)


def read(path: Path) -> list[Message]:
    with open_log(path) as log:
        messages = list(log.messages())
        assert not log.skipped
    return messages


def wait_until(condition, seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.01)


def test_messages_of_several_threads_are_all_recorded(tmp_path: Path):
    with Recorder(tmp_path / "a.mcap", {"robot": "p3dx"}) as recorder:
        recorder.add_metadata("laser", {"serial": "H1"})
        recorder.add_attachment("config.toml", b"x = 1", "application/toml")

        def feed(device: str) -> None:
            for k in range(500):
                assert recorder.put(RawBytes(k, device, "rx", bytes([k % 256])), receipt_ns=k + 1)

        threads = [threading.Thread(target=feed, args=(d,)) for d in ("p3dx", "laser")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    status = recorder.status()
    assert (status.written, status.lost, status.stopped) == (1000, 0, "")
    assert status.files == (tmp_path / "a.mcap",)
    with open_log(tmp_path / "a.mcap") as log:
        got = list(log.messages())
        assert log.metadata()["laser"] == {"serial": "H1"}
        assert log.metadata()["run"]["robot"] == "p3dx"
        assert [a.name for a in log.attachments()] == ["config.toml"]
    for device in ("p3dx", "laser"):
        assert [m.stamp_ns for m in got if m.device == device] == list(range(500))


class SlowDisk:
    """A clock that holds up whoever asks for the time, once it is told to."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()

    def __call__(self) -> float:
        self.go.wait(10)
        return time.monotonic()


def test_overflow_is_dropped_counted_and_noted_in_the_log(tmp_path: Path):
    disk = SlowDisk()
    config = RecorderConfig(queue_messages=50)
    recorder = Recorder(tmp_path / "a.mcap", config=config, clock=disk)
    disk.go.clear()
    time.sleep(0.2)  # the thread is held up in its tick
    taken = [recorder.put(odometry(k)) for k in range(80)]
    assert taken == [True] * 50 + [False] * 30
    disk.go.set()
    wait_until(lambda: recorder.status().queued == 0)
    assert recorder.put(odometry(99))
    status = recorder.close()
    assert (status.dropped, status.written, status.queued_most) == ({"/odom": 30}, 51, 50)
    assert [m.stamp_ns // 1_000_000 for m in read(tmp_path / "a.mcap")] == [*range(50), 99]
    with open_log(tmp_path / "a.mcap") as log:
        assert log.metadata()["recording"] == {"dropped /odom": "30"}


def test_what_cannot_be_encoded_is_refused_and_counted(tmp_path: Path):
    with Recorder(tmp_path / "a.mcap") as recorder:
        recorder.put(WheelOdometry(-1, 0.0, 0.0, 0.0))
        recorder.put(odometry(1))
    assert recorder.status().refused == {"/odom": 1}
    assert read(tmp_path / "a.mcap") == [odometry(1)]
    assert recorder.put(odometry(2)) is False


def test_data_reaches_the_disk_within_a_second_also_when_nothing_follows(tmp_path: Path):
    with Recorder(tmp_path / "a.mcap") as recorder:
        recorder.put(odometry(1))
        given = time.monotonic()
        partial = tmp_path / "a.mcap.partial"
        wait_until(lambda: recovered(partial, tmp_path / "r.mcap") == 1)
        assert time.monotonic() - given < 1.0


def recovered(source: Path, target: Path) -> int:
    """How many messages of a live recording are on the disk; `recover` wants an ended one."""
    copy = Path(shutil.copy(source, target.with_suffix(".copy")))
    return sum(recover(copy, target).messages.values())


def test_rotation_by_size_gives_files_that_stand_alone(tmp_path: Path):
    config = RecorderConfig(rotate_bytes=100_000)
    rng = np.random.default_rng(1)
    scans = [LaserScan(k, 0.0, 0.01, rng.random(1081).astype(np.float32)) for k in range(300)]
    with Recorder(tmp_path / "a.mcap", {"robot": "p3dx"}, config) as recorder:
        recorder.add_metadata("laser", {"serial": "H1"})
        recorder.add_attachment("config.toml", b"x = 1", "application/toml")
        recorder.put(LaserExtrinsics(0, 0.1, 0.0, 0.0))
        for scan in scans:
            recorder.put(scan)
    files = recorder.status().files
    assert len(files) >= 3
    assert [f.name for f in files] == [f"a_{k:03}.mcap" for k in range(len(files))]
    stamps = []
    for k, path in enumerate(files):
        messages = read(path)
        assert messages[0] == LaserExtrinsics(0, 0.1, 0.0, 0.0)
        stamps += [m.stamp_ns for m in messages[1:]]
        with open_log(path) as log:
            assert log.metadata()["run"] | {"part": str(k)} == log.metadata()["run"]
            assert log.metadata()["laser"] == {"serial": "H1"}
            assert [a.data for a in log.attachments()] == [b"x = 1"]
    assert stamps == list(range(300))


def test_rotation_by_time(tmp_path: Path):
    with Recorder(tmp_path / "a.mcap", config=RecorderConfig(rotate_s=0.2)) as recorder:
        for k in range(25):
            recorder.put(odometry(k))
            time.sleep(0.02)
    files = recorder.status().files
    assert 2 <= len(files) <= 4
    assert [m for f in files for m in read(f)] == [odometry(k) for k in range(25)]


def test_recording_stops_cleanly_before_the_disk_is_full(tmp_path: Path):
    free = [10**9]
    config = RecorderConfig(reserve_bytes=10**8)
    with Recorder(tmp_path / "a.mcap", config=config, free_bytes=lambda _: free[0]) as recorder:
        recorder.put(odometry(1))
        wait_until(lambda: recorder.status().written == 1)
        free[0] = 90_000_000
        wait_until(lambda: recorder.status().stopped)
        assert recorder.put(odometry(2)) is False
        recorder.add_metadata("late", {})  # the caller goes on and need not ask
    status = recorder.status()
    assert "85 MiB are free" in status.stopped
    assert status.refused == {"/odom": 1}
    assert read(tmp_path / "a.mcap") == [odometry(1)]


@contextmanager
def files_no_larger_than(size: int) -> Iterator[None]:
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def test_a_disk_that_fails_leaves_a_sound_prefix_and_a_clear_reason(tmp_path: Path):
    rng = np.random.default_rng(1)
    scans = [LaserScan(k, 0.0, 0.01, rng.random(1081).astype(np.float32)) for k in range(200)]
    with files_no_larger_than(300_000), Recorder(tmp_path / "a.mcap") as recorder:
        for scan in scans:
            recorder.put(scan)
        wait_until(lambda: recorder.status().stopped)
    status = recorder.status()
    assert "writing failed: File too large" in status.stopped
    assert "slam recover" in status.stopped
    assert status.files == ()
    assert status.written + status.refused["/scan"] == 200
    report = recover(tmp_path / "a.mcap.partial", tmp_path / "b.mcap")
    saved = read(tmp_path / "b.mcap")
    assert [m.stamp_ns for m in saved] == list(range(len(saved)))
    assert len(saved) >= 29  # a chunk at least
    assert report.unclosed


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("a small file system can be mounted by root only")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_spoils_nothing_that_was_written(small_disk: Path):
    rng = np.random.default_rng(1)
    scans = [LaserScan(k, 0.0, 0.01, rng.random(1081).astype(np.float32)) for k in range(400)]
    with Recorder(small_disk / "a.mcap", config=RecorderConfig(reserve_bytes=0)) as recorder:
        for scan in scans:
            recorder.put(scan)
        wait_until(lambda: recorder.status().stopped)
    assert "No space left on device" in recorder.status().stopped
    target = small_disk.parent / "b.mcap"
    recover(small_disk / "a.mcap.partial", target)
    saved = read(target)
    assert [m.stamp_ns for m in saved] == list(range(len(saved)))
    assert len(saved) > 50


def test_the_watch_stops_before_a_small_disk_is_full(small_disk: Path):
    rng = np.random.default_rng(1)
    config = RecorderConfig(reserve_bytes=300_000)
    with Recorder(small_disk / "a.mcap", config=config) as recorder:
        for k in range(400):
            recorder.put(LaserScan(k, 0.0, 0.01, rng.random(1081).astype(np.float32)))
            time.sleep(0.01)
            if recorder.status().stopped:
                break
    assert "free on the disk" in recorder.status().stopped
    saved = read(small_disk / "a.mcap")
    assert [m.stamp_ns for m in saved] == list(range(recorder.status().written))


def test_a_recording_replaces_nothing(tmp_path: Path):
    with Recorder(tmp_path / "a.mcap"):
        pass
    with pytest.raises(LogError, match="there already"):
        Recorder(tmp_path / "a.mcap")
    with pytest.raises(LogError, match="cannot be written"):
        Recorder(tmp_path / "nowhere" / "a.mcap")
    with Recorder(tmp_path / "b.mcap") as recorder, pytest.raises(LogError, match="plain"):
        recorder.add_attachment("../x", b"", "text/plain")


def test_an_exception_of_the_caller_still_gives_a_whole_file(tmp_path: Path):
    def interrupted() -> None:
        with Recorder(tmp_path / "a.mcap") as recorder:
            recorder.put(odometry(1))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert read(tmp_path / "a.mcap") == [odometry(1)]


def test_a_defect_in_the_thread_reaches_the_caller(tmp_path: Path, monkeypatch):
    def defective(*_) -> bool:
        raise ZeroDivisionError

    monkeypatch.setattr(PartWriter, "write", defective)
    recorder = Recorder(tmp_path / "a.mcap")
    recorder.put(odometry(1))
    with pytest.raises(ZeroDivisionError):
        recorder.close()
    assert "recording failed" in recorder.status().stopped


def test_ten_times_the_rate_of_the_sensors_is_sustained(tmp_path: Path):
    """1081 beams at 40 Hz, raw bytes beside them, and odometry at 10 Hz, all ten times."""
    rng = np.random.default_rng(1)
    scans = [LaserScan(k, 0.0, 0.004, rng.normal(5, 1, 1081).astype(np.float32)) for k in range(50)]
    raw = rng.integers(48, 111, 3300, dtype=np.uint8).tobytes()
    seconds, began = 1.5, time.monotonic()
    with Recorder(tmp_path / "a.mcap", config=RecorderConfig(recompress=False)) as recorder:
        for k in range(int(400 * seconds)):
            recorder.put(scans[k % 50])
            recorder.put(RawBytes(k, "laser", "rx", raw))
            if k % 4 == 0:
                recorder.put(odometry(k))
                recorder.put(RawBytes(k, "p3dx", "rx", raw[:40]))
            time.sleep(max(0.0, began + k / 400 - time.monotonic()))
        status = recorder.status()
    assert status.lost == 0
    assert recorder.status().written == int(400 * seconds) * 5 // 2
