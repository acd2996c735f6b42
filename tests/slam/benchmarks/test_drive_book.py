"""A campaign that is cut short goes on where it was, but never with another program's figures."""

import pytest

from benchmarks.drive_book import DriveBook

WHAT = {"config_sha256": "a", "program_sha256": "b"}
RUNS = [
    {"building": "clutter", "seed": 1, "fault": "none", "ate_m": 0.01},
    {"building": "clutter", "seed": 1, "fault": "stall", "ate_m": 0.02},
]


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "out" / "drives.jsonl"
    book = DriveBook(path, WHAT)
    book.add(("clutter", 1, None), RUNS[0])
    book.add(("clutter", 1, "stall"), RUNS[1])
    return path


def test_drives_are_found_again(path):
    assert DriveBook(path, WHAT).runs == {
        ("clutter", 1, None): RUNS[0], ("clutter", 1, "stall"): RUNS[1]
    }  # fmt: skip


def test_a_line_that_was_cut_short_is_driven_again(path):
    path.write_bytes(path.read_bytes()[:-5])
    book = DriveBook(path, WHAT)
    assert list(book.runs) == [("clutter", 1, None)]
    book.add(("clutter", 1, "stall"), RUNS[1])
    assert len(DriveBook(path, WHAT).runs) == 2


@pytest.mark.parametrize("key", WHAT)
def test_drives_of_another_program_do_not_count(path, key):
    assert DriveBook(path, WHAT | {key: "c"}).runs == {}
    assert DriveBook(path, WHAT).runs == {}
