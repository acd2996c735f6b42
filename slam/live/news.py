"""What the pipeline has put on record since it was last asked."""

from __future__ import annotations

from collections.abc import Sequence

from logs.messages import Message
from slam.pipeline import Slam


class News:
    """Remembers how many decisions, factors, verdicts and estimates are known."""

    def __init__(self) -> None:
        self._known = [0, 0, 0, 0]
        self._last_ns = 0  # stamp of the last keyframe that is known
        self._thinned_out = 0

    def take(self, slam: Slam) -> list[Message]:
        """The records that are new."""
        kept: tuple[Sequence[Message], ...] = (
            slam.decisions, slam.factors, slam.loops.verdicts, slam.estimates
        )  # fmt: skip
        if slam.thinned_out["keyframes"] != self._thinned_out:  # old records have gone, too
            self._thinned_out = slam.thinned_out["keyframes"]
            self._known = [sum(r.stamp_ns <= self._last_ns for r in records) for records in kept]
        if slam.decisions:
            self._last_ns = slam.decisions[-1].stamp_ns
        fresh = [
            r for known, records in zip(self._known, kept, strict=True) for r in records[known:]
        ]
        self._known = [len(records) for records in kept]
        return fresh
