"""A RUN directory is there whole or not at all."""

import pytest

from slam.runs.errors import RunError
from slam.runs.run_directory import new_run


def test_a_run_takes_its_name_when_it_is_complete(tmp_path):
    out = tmp_path / "run"
    with new_run(out) as partial:
        (partial / "a").write_text("x")
        assert not out.exists()
        assert partial.name == "run.partial"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert (out / "a").read_text() == "x"


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failed_run_leaves_nothing_not_even_its_folders(tmp_path, error):
    def fail():
        with new_run(tmp_path / "deep" / "er" / "run") as partial:
            (partial / "a").write_text("x")
            raise error

    with pytest.raises(error):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_there_stays(tmp_path):
    (tmp_path / "deep").mkdir()
    with pytest.raises(ValueError, match="x"), new_run(tmp_path / "deep" / "er" / "run"):
        raise ValueError("x")
    assert [p.name for p in tmp_path.rglob("*")] == ["deep"]


def test_a_failing_disk_is_a_run_error(tmp_path):
    with (
        pytest.raises(RunError, match="run: cannot be written: No space left"),
        new_run(tmp_path / "run"),
    ):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_already_is_not_touched(tmp_path):
    for out in (tmp_path / "folder", tmp_path / "file"):
        if out.name == "folder":
            out.mkdir()
        else:
            out.write_text("mine")
        with pytest.raises(RunError, match="exists already"), new_run(out):
            pytest.fail("the block must not be entered")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_partial_run_that_a_power_cut_left_is_replaced(tmp_path):
    (tmp_path / "run.partial").mkdir()
    (tmp_path / "run.partial" / "stale").write_text("x")
    with new_run(tmp_path / "run"):
        pass
    assert list((tmp_path / "run").iterdir()) == []


def test_a_partial_run_that_another_command_writes_is_left_alone(tmp_path):
    out = tmp_path / "run"
    with new_run(out) as partial:
        (partial / "a").write_text("x")
        with pytest.raises(RunError, match="run: is being written by another command"):
            new_run(out).__enter__()
        assert (partial / "a").read_text() == "x"
    assert (out / "a").read_text() == "x"


def test_a_file_in_the_way_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(RunError, match="run: cannot be written: Not a directory"),
        new_run(tmp_path / "file" / "run"),
    ):
        pytest.fail("the block must not be entered")


def test_a_partial_run_that_appears_at_the_same_moment_is_left_alone(tmp_path, monkeypatch):
    """Between the look and the making another command has made it."""
    theirs = tmp_path / "run.partial"
    theirs.mkdir()
    (theirs / "a").write_text("x")
    monkeypatch.setattr(type(theirs), "exists", lambda path: False)
    with (
        pytest.raises(RunError, match="run: cannot be written: File exists"),
        new_run(tmp_path / "run"),
    ):
        pytest.fail("the block must not be entered")
    assert (theirs / "a").read_text() == "x"
