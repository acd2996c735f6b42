from __future__ import annotations

import json
import tracemalloc
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.doctor import Diagnosis, Examination, diagnose
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry

START = 1_700_000_000_000_000_000
S = 1_000_000_000


def scan(stamp_ns: int, beams: int = 90, start: float = -1.57, **fields) -> LaserScan:
    rng = np.random.default_rng(stamp_ns % 2**32)
    return LaserScan(
        stamp_ns, start, np.pi / beams, rng.uniform(1, 9, beams).astype(np.float32), **fields
    )


def odometry(stamp_ns: int, x: float = 0.0, theta: float = 0.0) -> WheelOdometry:
    return WheelOdometry(stamp_ns, x, 0.0, theta)


def drive(n: int = 100) -> list[Message]:
    """Return a sound drive: 0.3 m/s, both sensors at 10 Hz."""
    messages: list[Message] = [LaserExtrinsics(START, 0.1, 0.0, 0.0)]
    for k in range(n):
        stamp = START + k * S // 10
        messages += [odometry(stamp, 0.03 * k), scan(stamp)]
    return messages


def codes(messages: Iterable[Message], delay_ns=lambda stamp_ns: 0) -> dict[str, tuple]:
    examination = Examination()
    for message in messages:
        examination.feed(message.stamp_ns + delay_ns(message.stamp_ns), message)
    return {f.code: (f.severity, f.count) for f in examination.findings()}


def moved(messages: list[Message], first: int, offset_ns: int) -> list[Message]:
    """Shift the stamps of the messages from the first one on."""
    out = []
    for k, message in enumerate(messages):
        values = {name: getattr(message, name) for name in message.__slots__}
        values["stamp_ns"] += offset_ns if k >= first else 0
        out.append(type(message)(**values))
    return out


def test_a_sound_drive_has_no_findings():
    assert codes(drive()) == {}
    assert codes(drive(), lambda stamp_ns: 5_000_000 + stamp_ns % 7_000_000) == {}


def test_a_simulated_drive_has_no_findings():
    messages = islice(simulate(scenario("testbed")), 600)
    assert codes(messages) == {}


def test_a_gap_of_minutes():
    found = codes(moved(drive(), 101, 300 * S))
    assert found == {"scan-gap": ("warning", 1), "odom-gap": ("warning", 1)}
    examination = Examination()
    for message in moved(drive(), 101, 300 * S):
        examination.feed(message.stamp_ns, message)
    (gap, _) = examination.findings()
    assert "5.0 min" in gap.text
    assert "moved" in gap.text
    assert gap.at_ns == START + 49 * S // 10


def test_stamps_of_1970_all_the_way_are_a_note_and_half_way_an_error():
    found = codes(moved(drive(), 0, -START))
    assert found == {"clock-unset": ("note", 100)}
    found = codes(moved(moved(drive(), 0, -START), 101, START))
    assert found["clock-set-late"] == ("error", 50)


def test_duplicate_and_backward_stamps():
    messages = drive()
    found = codes([*messages[:51], *messages[49:51], *messages[51:]])
    assert found == {"stamps-duplicate": ("warning", 1)}
    found = codes([*messages[:51], *messages[41:]])
    assert found["stamps-backwards"] == ("warning", 1)


def test_drift_steps_lateness_of_clocks():
    messages = drive(1200)
    found = codes(messages, lambda t: 10_000_000 + (t - START) * 300 // 10**6)
    assert found == {"clock-drift": ("warning", 1)}
    found = codes(messages, lambda t: 10_000_000 + (S if t - START > 60 * S else 0))
    assert found == {"clock-step": ("warning", 1)}
    assert codes(drive(), lambda t: S) == {"late": ("warning", 1)}
    assert codes(messages, lambda t: -20_000_000) == {"early": ("warning", 1)}
    jitter = np.random.default_rng(1).exponential(20e6, 10_000).astype(int)
    assert codes(messages, lambda t: int(jitter[t % 9973])) == {}


def test_changes_of_the_beams_and_two_lasers_on_one_channel():
    messages = drive()
    late = [scan(m.stamp_ns, 180) if isinstance(m, LaserScan) else m for m in messages[101:]]
    assert codes([*messages[:101], *late]) == {"beam-count": ("warning", 1)}
    both = [
        scan(m.stamp_ns, 180) if isinstance(m, LaserScan) and k % 4 == 0 else m
        for k, m in enumerate(messages)
    ]
    assert codes(both)["two-lasers"][0] == "error"
    rear = [
        scan(m.stamp_ns, 90, start=1.57) if isinstance(m, LaserScan) and k % 4 == 0 else m
        for k, m in enumerate(messages)
    ]
    assert codes(rear)["two-lasers"][0] == "error"
    mounts = [*messages, LaserExtrinsics(START, -0.1, 0.0, 3.14)]
    assert codes(mounts) == {"mount-changes": ("error", 1)}


def test_ranges():
    def with_ranges(ranges: np.ndarray, **fields) -> dict[str, tuple]:
        rng = np.random.default_rng(1)
        return codes(
            LaserScan(
                m.stamp_ns, -1.5, 0.03,
                (ranges + rng.normal(0, 0.001, ranges.size)).astype(np.float32), **fields,
            )
            if isinstance(m, LaserScan) else m
            for m in drive()
        )  # fmt: skip

    wall = np.full(90, 4.0)
    assert with_ranges(wall) == {}
    assert with_ranges(wall, range_max=3.0) == {"ranges-far": ("warning", 9000)}
    assert with_ranges(wall, range_min=5.0) == {"ranges-near": ("warning", 9000)}
    assert with_ranges(wall * np.inf) == {"blind-scans": ("warning", 100)}
    nan = wall.copy()
    nan[:60] = np.nan
    assert with_ranges(nan) == {"ranges-nan": ("warning", 6000)}


def test_limits_beyond_all_numbers():
    assert codes([*drive(), scan(START + 10 * S, range_max=1e300, range_min=-1e300)]) == {}


def test_a_laser_that_is_stuck():
    messages = drive()
    stuck = messages[2].ranges
    frozen = [
        LaserScan(m.stamp_ns, m.angle_min, m.angle_step, stuck) if isinstance(m, LaserScan) else m
        for m in messages
    ]
    assert codes(frozen) == {"frozen-scans": ("error", 95)}


def test_impossible_angles():
    bad = LaserScan(START, float("nan"), 0.1, np.ones(9, dtype=np.float32))
    wide = LaserScan(START + 1, 0.0, 1.0, np.ones(9, dtype=np.float32))
    assert codes([*drive(), bad, wide])["scan-geometry"] == ("error", 2)


def test_odometry():
    messages = drive()
    jump = [odometry(m.stamp_ns, m.x + 2.0) if k > 100 and isinstance(m, WheelOdometry) else m
            for k, m in enumerate(messages)]  # fmt: skip
    assert codes(jump) == {"odometry-jump": ("warning", 1)}
    still = [odometry(m.stamp_ns) if isinstance(m, WheelOdometry) else m for m in messages]
    assert codes(still) == {"odometry-still": ("warning", 1)}
    broken = [*messages, odometry(START + 20 * S, float("inf"))]
    assert codes(broken)["odometry-not-finite"] == ("error", 1)
    none = [m for m in messages if not isinstance(m, WheelOdometry)]
    assert codes(none) == {"no-odometry": ("warning", 1)}
    short = [m for k, m in enumerate(messages) if k < 50 or not isinstance(m, WheelOdometry)]
    assert codes(short)["scans-alone"] == ("warning", 65)


def test_the_mount():
    assert codes(drive()[1:]) == {"no-mount": ("warning", 1)}
    assert codes([*drive()[1:], LaserExtrinsics(START, 145.0, 0.0, 0.0)]) == {
        "mount-far": ("warning", 1)
    }


def test_nothing_but_odometry():
    assert codes([odometry(START)])["no-scans"] == ("error", 1)


def test_a_file_is_examined_and_the_result_is_json(tmp_path: Path):
    path = tmp_path / "a.mcap"
    with LogWriter(path) as log:
        log.add_metadata("recording", {"dropped /scan": "7"})
        for message in drive():
            log.write(message)
    diagnosis = diagnose(path)
    assert isinstance(diagnosis, Diagnosis)
    assert diagnosis.worst == "error"
    plain = json.loads(json.dumps(diagnosis.as_json(), allow_nan=False))
    assert plain["findings"][0]["code"] == "lost-recording"
    assert plain["findings"][0]["count"] == 7
    assert plain["drift_ppm"] == {"/scan": None, "/odom": None}


@pytest.mark.parametrize("n", [2000])
def test_memory_does_not_grow_with_the_log(n: int):
    def peak(count: int) -> int:
        examination = Examination()
        tracemalloc.start()
        for k in range(count):
            stamp = START + k * S // 10
            examination.feed(stamp + k, odometry(stamp, 0.03 * k))
            examination.feed(stamp + k, scan(stamp))
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    assert peak(5 * n) < 1.5 * peak(n) + 300_000


def beams(counts: Iterable[int], step=None, **fields) -> list[Message]:
    """A drive whose scans have these numbers of beams over a whole turn."""
    messages: list[Message] = [LaserExtrinsics(START, 0.1, 0.0, 0.0)]
    for k, n in enumerate(counts):
        stamp = START + k * S // 10
        ranges = np.random.default_rng(k).uniform(1, 9, n).astype(np.float32)
        messages += [
            odometry(stamp, 0.05 * k),
            LaserScan(stamp, -np.pi, step or 2 * np.pi / n, ranges, **fields),
        ]
    return messages


@pytest.mark.parametrize(("low", "high"), [(455, 456), (453, 457), (413, 1000)])
@pytest.mark.parametrize("step", [None, 2 * np.pi / 455])
def test_a_laser_whose_number_of_beams_varies_is_one_laser(low: int, high: int, step):
    if high == 1000 and step:
        return  # a constant step of so many beams is more than a turn
    counts = np.random.default_rng(2).integers(low, high + 1, 300)
    found = codes(beams(counts, step))
    assert found.keys() == {"beam-count"}
    assert found["beam-count"][0] == "warning"


def test_two_lasers_that_take_turns_are_still_two():
    messages = drive()
    apart = [
        scan(m.stamp_ns, 90, start=-1.57 + 0.5 * (k % 4 > 1)) if isinstance(m, LaserScan) else m
        for k, m in enumerate(messages)
    ]
    assert codes(apart)["two-lasers"][0] == "error"


def test_equal_scans_are_a_stuck_laser_only_where_the_robot_moves():
    messages = drive()
    same = messages[2].ranges

    def frozen(first: int, last: int, moving: bool) -> list[Message]:
        made = []
        for k, m in enumerate(messages):
            if isinstance(m, LaserScan) and first <= k < last:
                m = LaserScan(m.stamp_ns, m.angle_min, m.angle_step, same)
            elif isinstance(m, WheelOdometry) and not moving and k < last:
                m = odometry(m.stamp_ns, messages[last - 1 - last % 2].x)
            made.append(m)
        return made

    assert codes(frozen(1, 41, moving=False)) == {"still-scans": ("note", 15)}
    assert codes(frozen(1, 41, moving=True)) == {"frozen-scans": ("error", 15)}
    alone = [m for m in frozen(1, 41, moving=True) if not isinstance(m, WheelOdometry)]
    assert codes(alone)["still-scans"] == ("warning", 15)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_simulated_time_beside_receipts_of_today_is_one_note(factor: float):
    examination = Examination()
    for message in moved(drive(300), 0, S - START):
        receipt = START + int((message.stamp_ns - S) / factor)
        examination.feed(receipt, message)
    found = {f.code: f for f in examination.findings()}
    assert found.keys() == {"clock-unset"}
    assert "simulated time" in found["clock-unset"].text
    assert all(np.isnan(drift) for drift in examination.drift_ppm().values())


@pytest.mark.parametrize(
    ("apart_s", "found"),
    [(3600.0, {"clocks-apart": "error"}), (0.4, {"clocks-apart": "warning"}), (0.1, {})],
)
def test_clocks_of_laser_and_robot_apart(apart_s: float, found: dict[str, str]):
    examination = Examination()
    for message in drive():
        own = isinstance(message, WheelOdometry)
        late = odometry(message.stamp_ns - int(apart_s * S), message.x) if own else message
        examination.feed(message.stamp_ns + 1000, late)
    said = {f.code: f for f in examination.findings()}
    assert {c: f.severity for c, f in said.items() if c == "clocks-apart"} == found
    if apart_s == 3600.0:
        assert "differ by 3600 s" in said["clocks-apart"].text


def test_a_jump_beyond_all_sense_is_told_in_few_digits():
    wild = [*drive(), odometry(START + 20 * S, 1e256), odometry(START + 21 * S)]
    examination = Examination()
    for message in wild:
        examination.feed(message.stamp_ns, message)
    (jump,) = [f for f in examination.findings() if f.code == "odometry-jump"]
    assert "1e+256 m" in jump.text
    assert len(jump.text) < 100


def test_a_time_from_beam_to_beam_that_cannot_be():
    sound = {"beam_period_s": 0.1 / 360}
    assert codes(beams([360] * 50, **sound)) == {}
    assert codes(beams([360] * 50, beam_period_s=3e-5)) == {"scan-time": ("warning", 1)}
