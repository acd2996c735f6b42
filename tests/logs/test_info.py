from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from slam.logs.errors import TruncatedLog
from slam.logs.info import read_info
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserScan, RawBytes, WheelOdometry
from slam.logs.recover import recover
from slam.logs.sampled import Sampled
from slam.logs.timing import TimingCounter

START = 1_700_000_000_000_000_000
MS = 1_000_000


def write(path: Path, n: int = 100) -> Path:
    with LogWriter(path, {"robot": "p3dx", "id": "42"}) as log:
        log.add_metadata("laser", {"serial": "H\x1b1"})
        log.add_attachment("config.toml", b"a = 1", "application/toml")
        log.write(RawBytes(START, "laser", "rx", b"QT"))
        for k in range(n):
            stamp = START + 100 * MS * k + (3_000 * MS if k >= 60 else 0)
            log.write(WheelOdometry(stamp, 0.0, 0.0, 0.0), stamp + 5 * MS)
    return path


def test_a_log_at_a_glance(tmp_path: Path):
    path = write(tmp_path / "a.mcap")
    info = read_info(path)
    assert info.bytes == path.stat().st_size
    assert info.messages == 101
    assert info.duration_s == pytest.approx(0.1 * 99 + 3 + 0.005)
    assert info.run == {"robot": "p3dx", "id": "42", "schema_version": "1"}
    assert info.metadata == {"laser": {"serial": "H\x1b1"}}
    assert [(a.name, a.bytes) for a in info.attachments] == [("config.toml", 5)]
    assert not info.lost
    odom, raw = info.channels
    assert (odom.topic, odom.schema, odom.known) == ("/odom", "foxglove.Odometry", True)
    assert (raw.topic, raw.schema, raw.known, raw.bytes) == ("/raw/laser/rx", "", True, 2)
    assert odom.timing.rate_hz == pytest.approx(10.0)
    assert odom.timing.mean_rate_hz < 8.0
    (gap,) = odom.timing.gaps
    assert gap.start_ns == START + 59 * 100 * MS
    assert gap.seconds == pytest.approx(3.1)
    assert (odom.timing.backwards, odom.timing.duplicates) == (0, 0)


def test_what_the_recorder_dropped_and_what_was_recovered_is_shown(tmp_path: Path):
    with LogWriter(tmp_path / "a.mcap") as log:
        log.add_metadata("recording", {"dropped /scan": "7", "odd": "x"})
    info = read_info(tmp_path / "a.mcap")
    assert info.lost_recording == {"dropped /scan": 7}
    assert info.lost
    whole = write(tmp_path / "b.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) - 1200])
    with pytest.raises(TruncatedLog):
        read_info(tmp_path / "cut.mcap")
    report = recover(tmp_path / "cut.mcap", tmp_path / "c.mcap")
    lost = {"bytes that `slam recover` could not read": report.lost_bytes}
    assert read_info(tmp_path / "c.mcap").lost_recording == (lost if report.lost_bytes else {})


def test_damage_is_counted(tmp_path: Path):
    path = write(tmp_path / "a.mcap", 3)
    data = bytearray(path.read_bytes())
    at = data.index(b"\x28\xb5\x2f\xfd") + 40  # within the first compressed chunk
    data[at] ^= 0xFF
    path.write_bytes(data)
    info = read_info(path)
    assert info.lost
    assert sum(info.lost_reading.values()) >= 1


def test_an_empty_log(tmp_path: Path):
    with LogWriter(tmp_path / "a.mcap"):
        pass
    info = read_info(tmp_path / "a.mcap")
    assert (info.messages, info.duration_s, info.channels) == (0, 0.0, ())


def test_order_and_repeats_are_counted():
    counter = TimingCounter()
    for stamp_s in (10, 11, 12, 12, 11.5, 13, 14):
        counter.add(int(stamp_s * 1e9))
    timing = counter.result()
    assert (timing.messages, timing.duplicates, timing.backwards) == (7, 1, 1)
    assert timing.farthest_back_s == pytest.approx(0.5)
    assert timing.duration_s == pytest.approx(4.0)


def test_a_sample_is_bounded_and_its_median_close():
    sample = Sampled()
    for value in np.random.default_rng(1).permutation(100_000):
        sample.add(float(value))
    assert len(sample._kept) <= 4096
    assert sample.median == pytest.approx(50_000, rel=0.05)
    assert (sample.least, sample.most, sample.count) == (0.0, 99_999.0, 100_000)
    few = Sampled()
    for value in (3.0, 1.0, 2.0):
        few.add(value)
    assert few.median == 2.0


def test_scans_are_not_decoded(tmp_path: Path):
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write(LaserScan(START, 0.0, 0.1, np.ones(5, dtype=np.float32)))
    (channel,) = read_info(tmp_path / "a.mcap").channels
    assert channel.timing.messages == 1
    assert np.isnan(channel.timing.rate_hz)
