"""`slam info` and `slam doctor` in words."""

import json
from dataclasses import replace

import pytest
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserScan, LogLine

from slam.runs.errors import RunError
from slam.tools.inspect import describe_log, examine_log

ESCAPE = "\x1b[31mred\nline"


def write(path, messages, run=None, **metadata):
    with LogWriter(path, run or {}) as log:
        for message in messages:
            log.write(message)
        for name, values in metadata.items():
            log.add_metadata(name, values)
        log.add_attachment("notes.txt", b"abc", "text/plain")
    return path


@pytest.fixture(scope="module")
def drive():
    return list(simulate(scenario("testbed-180cm")))


@pytest.fixture(scope="module")
def gap(drive, tmp_path_factory):
    """A log with three seconds without scans, and names that would colour a terminal."""
    start = drive[0].stamp_ns
    silent = range(start + 2 * 10**9, start + 5 * 10**9)
    kept = [m for m in drive if not (isinstance(m, LaserScan) and m.stamp_ns in silent)]
    lost = {"dropped /scan": "7"}
    return write(
        tmp_path_factory.mktemp("gap") / "gap.mcap", kept, {"source": ESCAPE}, recording=lost
    )


def test_info_lists_channels_gaps_losses_identity_and_attachments(gap):
    told = describe_log(gap)
    for words in (
        "/scan", "10.00 Hz", "foxglove.LaserScan", "gap of 3.", "lost while recording: 7 dropped",
        "attachment: notes.txt, 3 bytes of text/plain", "schema_version: ", "2023-11-14 22:13",
    ):  # fmt: skip
        assert words in told
    assert "lost: nothing" not in told


def test_no_text_of_a_file_reaches_the_terminal_as_it_is(gap, drive, tmp_path):
    assert "\x1b" not in describe_log(gap)
    assert "source: \\x1b[31mred\\nline" in describe_log(gap)
    spoken = [LogLine(0, "error", ESCAPE, "x" * length) for length in (5, 90_000)]
    told = describe_log(write(tmp_path / "said.mcap", spoken * 60))
    assert "1970-01-01 00:00:00.000 UTC error: \\x1b[31mred\\nline xxxxx" in told
    assert told.count("error: ") == 20  # the last, without those that are too long
    assert "\x1b" not in told
    many = {f"{ESCAPE}{k}": "x" * 10_000 for k in range(1000)}
    told = describe_log(write(tmp_path / "many.mcap", drive, **{ESCAPE: many}))
    assert "\x1b" not in told
    assert "... and 950 more" in told
    assert len(told) < 20_000


def test_info_of_an_empty_log(tmp_path):
    told = describe_log(write(tmp_path / "empty.mcap", []))
    assert "0 messages in 0.0 s" in told
    assert "lost: nothing" in told


def test_the_doctor_finds_nothing_warns_or_fails(gap, drive, tmp_path):
    sound = write(tmp_path / "sound.mcap", drive)
    assert examine_log(sound) == (f"{sound}: nothing odd was found", 0)
    twice = [replace(m, stamp_ns=m.stamp_ns + 1) for m in drive if isinstance(m, LaserScan)][:1]
    again = write(tmp_path / "again.mcap", [*drive[:3], *twice, *drive[3:]])
    text, code = examine_log(again)
    assert code == 3
    assert "warning: " in text
    text, code = examine_log(gap)
    assert code == 1
    assert "error: lost while recording: 7" in text


def test_findings_for_programs(gap, tmp_path):
    examine_log(gap, tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["worst"] == "error"
    assert {"scan-gap", "lost-recording"} <= {f["code"] for f in found["findings"]}
    with pytest.raises(RunError, match=r"none/found\.json: cannot be written"):
        examine_log(gap, tmp_path / "none" / "found.json")
