"""`slam export`: an MCAP log in foreign formats."""

from __future__ import annotations

from pathlib import Path

from logs.exporters.carmen import write_carmen
from logs.mcap_log import open_log


def export_carmen(log: Path, out: Path) -> int:
    """Write a log as CARMEN text and return the number of scans.

    Raises:
        LogError: the log cannot be read, or the text cannot be written.
    """
    with open_log(log) as opened:
        return write_carmen(out, opened.messages(("/scan", "/odom", "/tf")))
