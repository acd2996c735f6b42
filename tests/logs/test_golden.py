"""Logs of every version so far stay readable, to the last bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from slam.logs.doctor import diagnose
from slam.logs.info import read_info
from slam.logs.mcap_log import SCHEMA_VERSION, open_log
from slam.logs.schemas import CHANNELS, topic_of

from tests.logs.golden.make_golden import digest

FOLDER = Path(__file__).parent / "golden"
FILES = sorted(FOLDER.glob("*.mcap"))


def test_there_is_a_golden_file_of_todays_schema():
    assert (FOLDER / f"schema{SCHEMA_VERSION}.mcap") in FILES


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_log_of_that_version_reads_as_it_was_written(path: Path):
    with open_log(path) as log:
        received = list(log.receipts())
        assert not log.skipped
        assert log.metadata()["laser"] == {"model": "URG-04LX", "serial": "H0000001"}
        (attached,) = log.attachments()
    assert (attached.name, attached.data) == ("config.toml", b"[matcher]\nkind = 'icp'\n")
    messages = [message for _, message in received]
    assert digest(messages) == path.with_suffix(".sha256").read_text().strip()
    assert all(receipt == message.stamp_ns + 3_000_000 for receipt, message in received)
    info = read_info(path)
    assert info.run["id"] == "golden"
    assert info.messages == len(messages)
    assert diagnose(path).worst != "error"


def test_the_golden_files_of_todays_schema_have_every_channel():
    topics = set()
    for path in FOLDER.glob(f"schema{SCHEMA_VERSION}*.mcap"):
        with open_log(path) as log:
            topics |= {topic_of(message) for message in log.messages()}
    assert topics == CHANNELS.keys()
