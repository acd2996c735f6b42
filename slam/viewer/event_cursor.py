"""What the pipeline has put on record since it was last asked."""

from __future__ import annotations

from collections.abc import Sequence

from slam.logs.messages import Message
from slam.mapping.slam import Slam


class EventCursor:
    """Remembers how many decisions, factors, closure results and estimates are known."""

    def __init__(self) -> None:
        self._known = [0, 0, 0, 0]
        self._last_ns = 0  # stamp of the last keyframe that is known
        self._pruned_count = 0

    def take(self, slam: Slam) -> list[Message]:
        """The records that are new."""
        records = slam.records
        kept: tuple[Sequence[Message], ...] = (
            records.decisions, records.factors, slam.loops.closure_results, records.estimates
        )  # fmt: skip
        if records.pruned_counts["keyframes"] != self._pruned_count:  # old ones have gone, too
            self._pruned_count = records.pruned_counts["keyframes"]
            self._known = [sum(r.stamp_ns <= self._last_ns for r in group) for group in kept]
        if records.decisions:
            self._last_ns = records.decisions[-1].stamp_ns
        fresh: list[Message] = []
        for known, group in zip(self._known, kept, strict=True):
            fresh += group[known:]
        self._known = [len(group) for group in kept]
        return fresh
