"""Files inside a log: config, calibration, reports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from slam.logs.errors import LogError
from slam.logs.mcap_file import RECORD_LIMIT

ATTACHMENT_LIMIT = RECORD_LIMIT - 4096  # bytes; the rest is for names and lengths

_NAME_LENGTH = 80  # characters, at most 4 bytes each: file systems allow 255 bytes


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside a log; its name has no folder in it."""

    name: str
    media_type: str
    data: bytes


def is_plain_name(name: str) -> bool:
    """Return whether a name is safe as a file's name in any folder, on any system."""
    return (
        0 < len(name) <= _NAME_LENGTH
        and name.isprintable()
        and not name.startswith(".")
        and not set(name) & set('/\\:*?"<>|')
    )


def check_attachment(log: Path, name: str, data: bytes) -> None:
    """Refuse an attachment that a log should not hold.

    Raises:
        LogError: if the name is not plain or the data too large.
    """
    if not is_plain_name(name):
        raise LogError(f"{log}: attachment name {name!r} is not a plain file name")
    if len(data) > ATTACHMENT_LIMIT:
        raise LogError(f"{log}: attachment {name} is larger than a log can hold")
