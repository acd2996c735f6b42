"""Messages at the pace at which they were measured, as a robot would send them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator

from slam.logs.messages import Message

LONGEST_S = 5.0
"""Gaps in a log count as no more than this: a clock that was set late leaves one of decades."""


def paced(
    messages: Iterable[Message],
    rate: float,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Message]:
    """Yield the messages unchanged, each not before its stamp is due; nobody waits for the past.

    Args:
        messages: in file order; stamps may run backwards, which takes no time.
        rate: 1 is real time, 2 twice as fast.
        now: s, monotonic.
        sleep: waits for so many seconds.
    """
    began, due_s = now(), 0.0
    newest_ns: int | None = None
    for message in messages:
        step_s = 0.0 if newest_ns is None else (message.stamp_ns - newest_ns) * 1e-9
        due_s += min(max(step_s, 0.0), LONGEST_S) / rate
        if newest_ns is None or step_s > 0.0 or step_s < -LONGEST_S:
            newest_ns = message.stamp_ns
        if (wait_s := due_s - (now() - began)) > 0.0:
            sleep(wait_s)
        yield message
