"""Where the messages of all devices get their one order: recorded first, then handed on.

The order in the log is the order in which the pipeline gets them, so that a replay of the
log is the same run.  What could not be recorded is not used either, and counted, until recording
has ended for want of room: from then on there is no log to agree with.
"""

from __future__ import annotations

import queue
import threading
from collections import Counter
from typing import NamedTuple, Protocol

from slam.drivers.connection import DeviceEvent, Received
from slam.logs.messages import LaserScan, Message, RawBytes
from slam.logs.schemas import topic_of
from slam.online.device_notes import line_of


class Taken(NamedTuple):
    """A recorded message and when its bytes were received, ns."""

    receipt_ns: int
    message: Message


class Log(Protocol):
    """What is needed of a `Recorder`."""

    def put(self, message: Message, receipt_ns: int | None = None) -> bool:
        """Take a message to be written and return whether it was taken."""
        ...

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add to a metadata record."""
        ...


class MessageSequencer:
    """The sink of every device thread; `get` gives the messages that the pipeline is for."""

    def __init__(self, log: Log, hand_on: bool = True) -> None:
        """Without `hand_on`, messages are recorded and counted only."""
        self.unrecorded: Counter[str] = Counter()  # per topic
        self.unlogged = False  # recording has ended: use messages all the same
        self.scans = 0
        self.last_scan_ns = 0  # receipt
        self._log, self._hand_on = log, hand_on
        self._lock = threading.Lock()
        self._inbox: queue.SimpleQueue[Taken] = queue.SimpleQueue()
        self._events: queue.SimpleQueue[DeviceEvent] = queue.SimpleQueue()

    def __call__(self, received: Received) -> None:
        """Record, then hand on; called from the devices' threads."""
        receipt_ns, message = received
        with self._lock:
            if isinstance(message, DeviceEvent):
                self._log.put(line_of(message))
                self._events.put(message)
                return
            if not self._log.put(message, receipt_ns):
                self.unrecorded[topic_of(message)] += 1
                if not self.unlogged:
                    return
            if isinstance(message, LaserScan):
                self.scans += 1
                self.last_scan_ns = receipt_ns
            if self._hand_on and not isinstance(message, RawBytes):
                self._inbox.put(Taken(receipt_ns, message))

    def get(self, timeout_s: float) -> Taken | None:
        """Return the next message in order, None if none came in time."""
        try:
            return self._inbox.get(timeout=timeout_s) if timeout_s > 0 else self._inbox.get_nowait()
        except queue.Empty:
            return None

    @property
    def waiting(self) -> int:
        """How many messages are recorded and not yet used."""
        return self._inbox.qsize()

    def events(self) -> list[DeviceEvent]:
        """Return what has happened to the devices since this was last called."""
        found = []
        while not self._events.empty():
            found.append(self._events.get())
        return found
