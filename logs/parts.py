"""A recording in one file or in several: the parts are read as the one log that they are.

The recorder numbers the parts `NAME_000.mcap`, `NAME_001.mcap`, ... and notes the number as
`part` in the run's identity.  Each part can be used alone for its decoded messages; the raw
bytes need the first part too, in which the devices say who they are.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from slam.logs.attachments import Attachment
from slam.logs.mcap_open import open_log
from slam.logs.messages import LaserExtrinsics, Message

_NUMBERED = re.compile(r"(?P<name>.*_)(?P<part>[0-9]{3,})(?P<suffix>\.[^.]*)")


def parts_of(path: Path | str) -> tuple[list[Path], list[int]]:
    """Return a log and the parts of the same recording that follow it, and the numbers missing.

    Raises:
        LogError: if one of them cannot be opened as one of our logs.
    """
    path = Path(path)
    run, named = _run_of(path), _NUMBERED.fullmatch(path.name)
    if named is None or run.pop("part", "") != str(int(named["part"])):
        return [path], []
    first = int(named["part"])
    found = {first: path}
    for other in path.parent.glob(f"*{named['suffix']}"):
        match = _NUMBERED.fullmatch(other.name)
        if match and match["name"] == named["name"] and int(match["part"]) > first:
            number = int(match["part"])
            if _run_of(other) == run | {"part": str(number)}:
                found[number] = other
    missing = sorted(set(range(first, max(found))) - found.keys())
    return [found[number] for number in sorted(found)], missing


def _run_of(path: Path) -> dict[str, str]:
    with open_log(path) as log:
        return log.metadata().get("run", {})


class Recording:
    """The parts from the named one on, read one after the other like a `Log`."""

    def __init__(self, path: Path | str) -> None:
        """Look for the parts.

        Raises:
            LogError: if one of them cannot be opened as one of our logs.
        """
        self.path = Path(path)
        self.files, self.missing = parts_of(path)
        self.skipped: Counter[str] = Counter()

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the messages on the given topics (all of ours), part after part."""
        for _, message in self.receipts(topics):
            yield message

    def receipts(self, topics: Collection[str] | None = None) -> Iterator[tuple[int, Message]]:
        """Yield each message with its time of receipt in ns, part after part.

        A part repeats the laser's mount for those who have it alone; here it is left out.
        """
        self.skipped.clear()
        self.skipped.update({f"part {number} is missing": 1 for number in self.missing})
        extrinsics: LaserExtrinsics | None = None
        for path in self.files:
            with open_log(path) as log:
                for receipt_ns, message in log.receipts(topics):
                    if isinstance(message, LaserExtrinsics):
                        if message == extrinsics:
                            continue
                        extrinsics = message
                    yield receipt_ns, message
                self.skipped.update(log.skipped)

    def counts(self) -> dict[str, int]:
        """Return the number of messages per topic."""
        counts: Counter[str] = Counter()
        for path in self.files:
            with open_log(path) as log:
                counts.update(log.counts())
        return dict(counts)

    def attachments(self) -> list[Attachment]:
        """Return the attached files; the recorder repeats them in every part."""
        with open_log(self.files[0]) as log:
            return list(log.attachments())

    @property
    def begins_late(self) -> bool:
        """Whether a part came before the one that was named."""
        return _run_of(self.files[0]).get("part", "0") != "0"
