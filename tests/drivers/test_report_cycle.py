import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.report_cycle import ReportCycle

MS = 1_000_000
EPOCH = 1_700_000_000_000_000_000
CYCLE = 100 * MS


def errors_ms(late_ms, *, cycle_ms=100.0, lost=(), told_ms=100):
    """By how much stamps are off when report k is `late_ms[k]` late and some are lost."""
    cycle, errors, last = ReportCycle(told_ms * MS), [], 0
    for k, late in enumerate(late_ms):
        if k in lost:
            continue
        true = EPOCH + round(k * cycle_ms * MS)
        last = max(last, true + round(late * MS))  # bytes do not overtake each other
        errors.append((cycle.stamp(last) - true) / MS)
    return np.array(errors)


def test_punctual_reports_keep_their_times():
    assert np.abs(errors_ms(np.zeros(100))).max() < 1e-5


@pytest.mark.parametrize("cycle_ms", [100.0, 100.4, 98.5, 103.0])
def test_the_jitter_of_usb_adapters_is_taken_out(cycle_ms):
    late = np.random.default_rng(1).uniform(0.0, 16.0, 400)  # an FTDI's latency timer
    errors = errors_ms(late, cycle_ms=cycle_ms)
    assert np.sqrt((errors[20:] ** 2).mean()) < 2.5  # without: 9.2
    assert np.abs(errors[60:]).max() < 8.0


def test_reports_that_come_in_pairs_are_spread_again():
    late = np.where(np.arange(200) % 2 == 0, 80.0, 1.0)
    assert np.abs(errors_ms(late)[10:]).max() < 5.0


def test_a_lost_report_leaves_a_gap_and_nothing_else():
    late = np.random.default_rng(2).uniform(0.0, 5.0, 100)
    assert np.abs(errors_ms(late, lost=(30, 31, 60))[5:]).max() < 6.0


def test_reports_found_together_are_put_in_their_places():
    """The host was busy for 0.8 s and finds eight reports at once."""
    cycle, errors = ReportCycle(CYCLE), []
    for k in range(100):
        stalled = 40 <= k < 48
        received = EPOCH + (47 if stalled else k) * CYCLE + 2 * MS * stalled
        stamp = cycle.stamp(received, 47 - k if stalled else 0)
        errors.append((stamp - EPOCH - k * CYCLE) / MS)
    assert np.abs(errors).max() < 3.0


def test_a_host_that_was_busy_does_not_move_the_times():
    late = np.zeros(100)
    late[40:43] = [250.0, 150.0, 50.0]  # three reports at once
    errors = errors_ms(late)
    assert np.abs(errors[45:]).max() < 1.0
    assert np.abs(errors[:40]).max() < 1.0


@pytest.mark.parametrize("cycle_ms", [50.0, 120.0])
def test_a_cycle_other_than_told_is_no_worse_than_the_receipt(cycle_ms):
    late = np.random.default_rng(3).uniform(0.0, 5.0, 300)
    assert np.abs(errors_ms(late, cycle_ms=cycle_ms)[50:]).max() < 12.0


def test_behind_a_long_gap_a_new_cycle_begins():
    cycle = ReportCycle(CYCLE)
    for k in range(20):
        cycle.stamp(EPOCH + k * CYCLE)
    again = EPOCH + 10_000 * MS + 37 * MS
    assert cycle.stamp(again) == again


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 3_000_000_000), max_size=120), st.integers(1, 2_000))
def test_stamps_rise_and_are_not_before_their_time(gaps, cycle_ms):
    cycle, now, last = ReportCycle(cycle_ms * MS), EPOCH, 0
    for gap in gaps:
        now += gap
        stamp = cycle.stamp(now)
        assert last < stamp <= max(now, last + 1)
        last = stamp


def test_equal_receipts_give_equal_stamps():
    late = np.random.default_rng(4).uniform(0.0, 60.0, 200)
    np.testing.assert_array_equal(errors_ms(late), errors_ms(late))


def test_a_cycle_takes_time():
    with pytest.raises(ValueError, match="takes time"):
        ReportCycle(0)
