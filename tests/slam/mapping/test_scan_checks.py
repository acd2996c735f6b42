"""Beam times that cannot be, and a range that means nothing came back."""

import math

import numpy as np
import pytest
from slam.logs.messages import LaserScan

from slam.mapping.scan_checks import BeamTiming, NothingCode

TURN_S = 0.2


def scans(beam_period_s, count=12, beams=360):
    rng = np.random.default_rng(0)
    return [
        LaserScan(
            round(k * TURN_S * 1e9), 0.0, 2 * math.pi / beams,
            rng.uniform(1.0, 3.0, beams).astype(np.float32), 0.0, 12.0, beam_period_s,
        )
        for k in range(count)
    ]  # fmt: skip


@pytest.mark.parametrize("sweep_s", [TURN_S, 0.6 * TURN_S])
def test_beam_times_that_fill_a_good_part_of_the_period_are_believed(sweep_s):
    timing = BeamTiming()
    seen = [timing.checked(scan) for scan in scans(sweep_s / 360)]
    assert all(scan.beam_period_s for scan in seen)
    assert timing.contradicted == 0


@pytest.mark.parametrize("sweep_s", [0.011, 0.9])
def test_beam_times_that_contradict_the_period_are_not(sweep_s):
    timing = BeamTiming()
    seen = [timing.checked(scan) for scan in scans(sweep_s / 360)]
    assert timing.contradicted == len(seen) - 3
    assert not any(scan.beam_period_s for scan in seen[3:])


def coded(code, share, count=12):
    rng = np.random.default_rng(1)
    return [
        LaserScan(s.stamp_ns, s.angle_min, s.angle_step,
                  np.where(rng.random(360) < share, np.float32(code), s.ranges), 0.0, 3.5)
        for s in scans(0.0, count)
    ]  # fmt: skip


@pytest.mark.parametrize(("share", "after"), [(1.0, 0), (0.22, 0), (0.05, 4)])
def test_a_code_for_nothing_is_found_and_removed(share, after):
    found = NothingCode()
    seen = [found.removed(scan) for scan in coded(3.496, share)]
    assert found.code == pytest.approx(3.496, abs=1e-6)
    assert not any((scan.ranges == np.float32(3.496)).any() for scan in seen[after:])


def test_a_reading_beyond_shows_that_it_was_no_code():
    found = NothingCode()
    for scan in coded(2.9999, 0.3):
        found.removed(scan)
    farther = scans(0.0, 1)[0]
    farther = LaserScan(0, 0.0, farther.angle_step, np.full(360, 3.2, np.float32), 0.0, 3.5)
    found.removed(farther)
    assert found.code != pytest.approx(2.9999)


def test_a_room_without_codes_has_none():
    found = NothingCode()
    seen = [found.removed(scan) for scan in scans(0.0)]
    assert found.code is None
    assert found.beams == 0
    assert all(np.isfinite(scan.ranges).all() for scan in seen)
