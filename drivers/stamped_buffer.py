"""A receive buffer that knows when each of its bytes came in."""

from __future__ import annotations

from collections import deque


class StampedBuffer:
    """Bytes waiting to be cut into packets, with the receive time of every one of them.

    A packet may be recognised long after it came in, when garbage in front of it had to be
    ruled out first; its stamp must not suffer from that.
    """

    def __init__(self) -> None:
        self.data = bytearray()
        self._start = 0  # position in the stream of data[0]
        self._chunks: deque[tuple[int, int]] = deque()  # (stream position of the end, stamp)

    def append(self, data: bytes, stamp_ns: int) -> None:
        """Add bytes that were received at `stamp_ns`."""
        if data:
            self.data += data
            self._chunks.append((self._start + len(self.data), stamp_ns))

    def stamp(self, index: int) -> int:
        """Return when byte `index` of `data` was received, ns.

        Raises:
            IndexError: if there is no such byte.
        """
        for end, stamp_ns in self._chunks:
            if self._start + index < end:
                return stamp_ns
        raise IndexError(f"byte {index} of {len(self.data)}")

    def drop(self, count: int) -> None:
        """Forget the first `count` bytes."""
        del self.data[:count]
        self._start += count
        while self._chunks and self._chunks[0][0] <= self._start:
            self._chunks.popleft()
