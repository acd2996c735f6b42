"""Robot and laser with faults on their wires, in simulated time: the whole online path but threads.

All 200 runs are `slam bench online-faults`; here are one without faults, one of each kind that
needs a reconnection or loses data, and, marked slow, every tenth of the campaign.
"""

import pytest

from benchmarks.faults.drive import DriveFaults
from benchmarks.faults.online_faults import KINDS, RUNS, draw, drive_once, fault_free_m, run_one


def test_without_faults_nothing_is_lost_and_the_replay_is_the_same_run():
    row = drive_once(0, DriveFaults())
    assert row["wrong"] == []
    assert row["scans_lost"] == sum(row["outages"].values()) == 0
    assert row["pipeline_lost"] == {}
    assert row["error_m"] < 0.03
    assert row["stamp_ms_max"] < 2.0


NAMES = list(KINDS)


@pytest.mark.parametrize("name", ["bit flips", "unplugged", "robot reboots"])
def test_faults_leave_the_track_and_the_replay_alone(name):
    row = run_one(NAMES.index(name))
    assert row["faults"] == name
    assert row["wrong"] == []
    assert row["ratio"] < 2.0


def test_the_campaign_has_every_kind_alone_and_in_mixtures():
    faults = [draw(seed)[0] for seed in range(RUNS)]
    assert all(faults.count(name) == 10 for name in NAMES)
    mixtures = [name for name in faults if " + " in name]
    assert len(mixtures) == RUNS - 10 * len(NAMES)
    assert all(any(name in mixture for mixture in mixtures) for name in NAMES)
    assert draw(RUNS - 1) == draw(RUNS - 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5, RUNS, 10))
def test_campaign(seed):
    assert run_one(seed)["wrong"] == []


def test_the_error_without_faults_is_small():
    assert fault_free_m(1) < 0.01
