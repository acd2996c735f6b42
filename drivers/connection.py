"""The one place where bytes of a device pass: stamped, recorded and decoded in this order."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, Protocol, TypeVar, cast, get_args

from slam.drivers.errors import Stopped
from slam.drivers.ports import Port
from slam.logs.messages import RawBytes, SensorMessage

DeviceName = Literal["p3dx", "laser"]
EventKind = Literal["connected", "resumed", "lost", "failed", "closed", "notice"]
Clock = Callable[[], int]  # UTC in ns
Part = TypeVar("Part")
Part_co = TypeVar(
    "Part_co", covariant=True
)  # what a protocol cuts its bytes into: packets or replies
_MESSAGES = get_args(SensorMessage)
_SLICE_S = 0.1  # s, how soon a wait notices that it was called off


@dataclass(frozen=True, slots=True)
class DeviceEvent:
    """A change in the connection to a device, for the log and for the operator.

    A "notice" leaves the connection as it is: the device has said something about itself.
    """

    stamp_ns: int
    device: DeviceName
    kind: EventKind
    detail: str  # in words


class Received(NamedTuple):
    """What a device thread hands over, in the order in which it became known."""

    receipt_ns: int  # of the bytes that brought it
    message: SensorMessage | DeviceEvent


Sink = Callable[[Received], None]


class Decoder(Protocol[Part_co]):
    """Pure: equal raw bytes with equal stamps give equal messages."""

    def accept(self, raw: RawBytes) -> Iterator[Part_co | SensorMessage]:
        """Yield parts of the protocol and the messages they carry."""
        ...

    def decode(self, raw: RawBytes) -> Iterator[SensorMessage]:
        """Yield the messages alone, as a replay wants them."""
        ...

    def counters(self) -> dict[str, int]:
        """What came in and what was lost, by cause."""
        ...


def steady_utc() -> Clock:
    """Return a clock that starts at UTC and then keeps its pace, whatever NTP does."""
    offset = time.time_ns() - time.monotonic_ns()
    return lambda: offset + time.monotonic_ns()


class Connection(Generic[Part]):
    """A port whose traffic is recorded in both directions and decoded on the way."""

    def __init__(
        self,
        device: DeviceName,
        port: Port,
        decoder: Decoder[Part],
        sink: Sink,
        clock: Clock,
        cancelled: threading.Event,
    ) -> None:
        self.port = port
        self._cancelled = cancelled
        self._device, self._decoder = device, decoder
        self._sink, self._clock = sink, clock

    def send(self, data: bytes) -> None:
        """Record, then send; the stamp must not come after an answer's."""
        self._pass(RawBytes(self._clock(), self._device, "tx", data))
        self.port.write(data)

    def receive(self, timeout_s: float) -> list[Part]:
        """Wait for bytes once and return the parts they complete; their messages are handed on."""
        data = self.port.read(timeout_s)
        return self._pass(RawBytes(self._clock(), self._device, "rx", data)) if data else []

    def receive_for(self, seconds: float) -> Iterator[Part]:
        """Yield the parts that come in within so many seconds.

        Raises:
            Stopped: if that has been called off.
        """
        deadline = self._clock() + round(seconds * 1e9)
        while (left := deadline - self._clock()) > 0:
            if self._cancelled.is_set():
                raise Stopped("called off")
            yield from self.receive(min(left * 1e-9, _SLICE_S))

    def drain(self, quiet_s: float, at_most_s: float) -> None:
        """Read until nothing has come for `quiet_s`, or time is up; all of it is recorded."""
        end = self._clock() + round(at_most_s * 1e9)
        while self._clock() < end:
            data = self.port.read(quiet_s)
            if not data:
                return
            self._pass(RawBytes(self._clock(), self._device, "rx", data))

    def _pass(self, raw: RawBytes) -> list[Part]:
        self._sink(Received(raw.stamp_ns, raw))
        parts: list[Part] = []
        for item in self._decoder.accept(raw):
            if isinstance(item, _MESSAGES):
                self._sink(Received(raw.stamp_ns, item))
            else:
                parts.append(cast(Part, item))
        return parts
