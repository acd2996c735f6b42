"""ARCOS on the wire: packets and commands of Pioneer robots, in both directions.

Sections are those of docs/devices.md, which names the sources.  A packet is
`FA FB count id data checksum`, with count the number of bytes behind it (section 1).
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from slam.drivers.stamped_buffer import StampedBuffer

HEADER = b"\xfa\xfb"
MIN_COUNT = 3  # an id and a checksum
MAX_COUNT = 249  # largest count byte in the manuals (section 1)
PATIENCE_NS = 100_000_000  # ARIA gives up on half a packet after 100 ms (section 1, resync)

_POSITIVE, _NEGATIVE, _STRING = 0x3B, 0x1B, 0x2B  # argument types (section 1)


class Id(IntEnum):
    """Command numbers (section 1.3); 0 to 2 mean SYNC0 to SYNC2 until the robot is connected."""

    PULSE = 0
    OPEN = 1
    CLOSE = 2
    POLLING = 3
    ENABLE = 4
    SETA = 5
    SETV = 6
    SETO = 7
    MOVE = 8
    ROTATE = 9
    SETRV = 10
    VEL = 11
    HEAD = 12
    DHEAD = 13
    CONFIG = 18
    ENCODER = 19
    RVEL = 21
    DCHEAD = 22
    SETRA = 23
    SONAR = 28
    STOP = 29
    VEL2 = 32
    IOREQUEST = 40
    BUMPSTALL = 44
    HOSTBAUD = 50
    E_STOP = 55
    E_STALL = 56
    GYRO = 58
    BATTERYINFO = 62
    BATTEST = 250
    RESET = 253


SYNC0, SYNC1, SYNC2 = 0, 1, 2
OUT_OF_SYNC = 0xFF  # answer to a SYNC in the wrong order (section 1.1)
BAUD_CODES = {9600: 0, 19200: 1, 38400: 2, 57600: 3, 115200: 4}  # argument of HOSTBAUD


class Packet(NamedTuple):
    """What stood between count and checksum, and when it was received."""

    payload: bytes  # id and data
    stamp_ns: int  # receive time of the last byte
    begun_ns: int  # receive time of the first byte

    @property
    def id(self) -> int:
        """Command number or report type."""
        return self.payload[0]


class Command(NamedTuple):
    """A command with its argument: an integer, a string, or none."""

    id: int
    argument: int | bytes | None = None


def checksum(payload: bytes | bytearray) -> int:
    """Add big-endian byte pairs modulo 2**16, then XOR a left-over byte (section 1)."""
    pairs = len(payload) // 2
    total: int = sum(struct.unpack_from(f">{pairs}H", payload)) & 0xFFFF
    return total ^ payload[-1] if len(payload) % 2 else total


def encode_packet(payload: bytes) -> bytes:
    """Put header, count and checksum around id and data.

    Raises:
        ValueError: if nothing or more than a packet can hold is given.
    """
    count = len(payload) + 2
    if not MIN_COUNT <= count <= MAX_COUNT:
        raise ValueError(f"a packet holds 1 to {MAX_COUNT - 2} bytes, got {len(payload)}")
    return HEADER + bytes([count]) + payload + checksum(payload).to_bytes(2, "big")


def encode_command(number: int, argument: int | bytes | None = None) -> bytes:
    """Return the packet of a command; negative numbers go as magnitude and sign (section 1).

    Raises:
        ValueError: if the argument does not fit.
    """
    if argument is None:
        return encode_packet(bytes([number]))
    if isinstance(argument, bytes):
        if len(argument) > MAX_COUNT - 5:
            raise ValueError(f"a string argument of {len(argument)} bytes is too long")
        return encode_packet(bytes([number, _STRING, len(argument)]) + argument)
    if abs(argument) > 0xFFFF:
        raise ValueError(f"the argument {argument} does not fit into 16 bits")
    kind = _POSITIVE if argument >= 0 else _NEGATIVE
    return encode_packet(bytes([number, kind]) + abs(argument).to_bytes(2, "little"))


def decode_command(payload: bytes) -> Command | None:
    """Return the command in a packet, None if its argument is of no known type.

    An integer type without its integer is what Player sends for SETO: no argument.
    """
    number, rest = payload[0], payload[1:]
    if not rest:
        return Command(number)
    kind, value = rest[0], rest[1:]
    if kind in (_POSITIVE, _NEGATIVE):
        if len(value) < 2:
            return Command(number)
        magnitude = int.from_bytes(value[:2], "little")
        return Command(number, magnitude if kind == _POSITIVE else -magnitude)
    if kind == _STRING and value:
        return Command(number, value[1 : 1 + value[0]])
    return None


def vel2_argument(left: int, right: int) -> int:
    """Pack signed wheel speeds, in units of 20 mm/s: right in the low byte (section 1.3)."""
    return (left & 0xFF) << 8 | (right & 0xFF)


class Framer:
    """Cuts a byte stream into ARCOS packets; damaged bytes are skipped and counted."""

    def __init__(self) -> None:
        self.packets = 0
        self.skipped_bytes = 0
        self.bad_checksums = 0
        self._buffer = StampedBuffer()

    @property
    def pending(self) -> int:
        """How many bytes wait for the rest of their packet; fewer than one packet has."""
        return len(self._buffer.data)

    def feed(self, data: bytes, stamp_ns: int) -> list[Packet]:
        """Return the packets that `data`, received at `stamp_ns`, completes.

        Header bytes may occur in data, so a packet is skipped as a whole.  Behind a wrong
        checksum the search goes on one byte after the false header.
        """
        self._buffer.append(data, stamp_ns)
        packets: list[Packet] = []
        while self._find_header():
            end = self._end_at(0)
            if end is None:
                self._skip(1)
            elif end > self.pending:
                if not self._give_way(stamp_ns):
                    break
            elif not self._is_sound(0, end):
                self.bad_checksums += 1
                self._skip(1)
            else:
                packets.append(self._take(end))
        return packets

    def _find_header(self) -> bool:
        """Skip to the next header; True once its count is there too."""
        at = self._buffer.data.find(HEADER)
        if at < 0:
            half = self._buffer.data.endswith(HEADER[:1])
            self._skip(self.pending - half)
            return False
        self._skip(at)
        return self.pending > len(HEADER)

    def _end_at(self, start: int) -> int | None:
        """Return where the packet with its header at `start` ends, None if its count cannot be."""
        count = self._buffer.data[start + 2]
        return start + 3 + count if MIN_COUNT <= count <= MAX_COUNT else None

    def _is_sound(self, start: int, end: int) -> bool:
        data = self._buffer.data
        return checksum(data[start + 3 : end - 2]) == int.from_bytes(data[end - 2 : end], "big")

    def _give_way(self, now_ns: int) -> bool:
        """Skip a packet that waits too long for its end if a whole one has come in behind it.

        Otherwise a damaged count would hold back what follows it.
        """
        if now_ns - self._buffer.stamp(0) <= PATIENCE_NS:
            return False
        at = self._buffer.data.find(HEADER, 1)
        while 0 <= at < self.pending - 2:
            end = self._end_at(at)
            if end is not None and end <= self.pending and self._is_sound(at, end):
                self.bad_checksums += 1
                self._skip(at)
                return True
            at = self._buffer.data.find(HEADER, at + 1)
        return False

    def _take(self, end: int) -> Packet:
        payload = bytes(self._buffer.data[3 : end - 2])
        packet = Packet(payload, self._buffer.stamp(end - 1), self._buffer.stamp(0))
        self._buffer.drop(end)
        self.packets += 1
        return packet

    def _skip(self, count: int) -> None:
        if count:
            self._buffer.drop(count)
            self.skipped_bytes += count
