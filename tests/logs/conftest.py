"""What the tests of logs share."""

from __future__ import annotations

import pytest


@pytest.fixture
def no_sync(monkeypatch):
    """Let thousands of files be written without waiting for the disk each time."""
    monkeypatch.setattr("slam.logs.partial.os.fsync", lambda _: None)
