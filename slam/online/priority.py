"""What keeps the interpreter and the system from pausing the pipeline while a robot drives."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_SWITCH_S = 0.0005  # s until a thread must let another one go on; Python's own 5 ms are a delay
_NICER = 10  # of a search: it gets what the pipeline and the readers leave of the processor


@contextmanager
def prioritised() -> Iterator[None]:
    """Enclose the drive: no long pauses of the interpreter.

    Modules and compiled kernels are some 200 000 objects: to look through them for garbage
    takes 0.1 s, and they are no garbage.
    """
    interval = sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()


def lower_priority() -> None:
    """Let the thread that calls this wait for all others; Linux alone has priorities of threads."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICER)
