"""SCIP 2.x on the wire: commands, replies and sums of Hokuyo range finders.

Sections are those of docs/devices.md, which names the sources.  Everything is ASCII lines; a
reply is the echo of its command, a status, lines with a sum each, and an empty line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

from slam.drivers.scip_status import status_name
from slam.drivers.stamped_buffer import StampedBuffer

LINE = 64  # characters of data in a line (section 4)
MAX_REPLY = 32768  # three echoes with intensity take 22 kB; more than this is garbage
MAX_COMMAND = 64  # longest line a client sends, user string included, and some

_COMMAND = re.compile(rb"(%?[A-Z]{2}|SCIP2\.0)([0-9]*)(?:;([A-Za-z0-9 ._+@]{0,16}))?")
_SYMBOLS = "BM CR GD GE GS HS II MD ME MS PP QT RB RS RT SS TM VV %ST %SL SCIP2.0".split()


def checksum(text: bytes | bytearray) -> int:
    """Return the sum character of a line: six bits, put among the printable ones (section 4)."""
    return (sum(text) & 0x3F) + 0x30


def with_sum(text: bytes) -> bytes:
    """Return a data or status line with its sum."""
    return text + bytes([checksum(text)])


def is_sound(line: bytes) -> bool:
    """Whether the last character of a data or status line is its sum."""
    return len(line) > 1 and checksum(line[:-1]) == line[-1]


def encode_number(value: int, characters: int) -> bytes:
    """Write `value` in groups of six bits, the highest first (section 4, encoding).

    Raises:
        ValueError: if it does not fit.
    """
    if not 0 <= value < 1 << 6 * characters:
        raise ValueError(f"{value} does not fit into {characters} characters")
    return bytes((value >> 6 * k & 0x3F) + 0x30 for k in reversed(range(characters)))


def decode_number(text: bytes) -> int:
    """Read the number that `encode_number` wrote.

    Raises:
        ValueError: if a character is outside 0x30 to 0x6F.
    """
    value = 0
    for character in text:
        if not 0x30 <= character < 0x70:
            raise ValueError(f"{text!r} is not a SCIP number")
        value = value << 6 | character - 0x30
    return value


@dataclass(frozen=True, slots=True)
class Command:
    """A command as a sensor reads it."""

    symbol: str
    digits: str = ""
    note: str | None = None  # user string, comes back in the echo

    def encode(self) -> bytes:
        """Return the line without its end."""
        tail = "" if self.note is None else f";{self.note}"
        return f"{self.symbol}{self.digits}{tail}".encode("ascii")


def decode_command(line: bytes) -> Command | None:
    """Return the command in a line, None if it is none."""
    match = _COMMAND.fullmatch(line)
    if match is None:
        return None
    symbol, digits, note = (None if part is None else part.decode() for part in match.groups())
    return Command(symbol or "", digits or "", note)


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply; `lines` still carry their sums, because information lines sum differently."""

    echo: bytes
    status: str
    lines: tuple[bytes, ...]
    stamp_ns: int  # receive time of the last byte
    begun_ns: int  # receive time of the first byte

    @property
    def symbol(self) -> str:
        """Which command is answered."""
        command = decode_command(self.echo)
        return command.symbol if command else ""

    @property
    def status_name(self) -> str:
        """The status in words."""
        return status_name(self.symbol, self.status)


def encode_reply(echo: bytes, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a whole reply; `lines` already carry their sums."""
    return b"\n".join([echo, with_sum(status.encode()), *lines]) + b"\n\n"


def data_lines(text: bytes) -> list[bytes]:
    """Cut encoded data into lines with sums; numbers may cross from one to the next."""
    return [with_sum(text[at : at + LINE]) for at in range(0, len(text), LINE)]


def joined_data(lines: Iterable[bytes]) -> bytes | None:
    """Put data lines together without their sums, None if any of them is damaged."""
    parts = []
    for line in lines:
        if not is_sound(line):
            return None
        parts.append(line[:-1])
    return b"".join(parts)


def information_line(key: str, value: str) -> bytes:
    """Return a line of VV, PP or II; the semicolon is not in the sum (section 4)."""
    text = f"{key}:{value}".encode("latin-1")
    return text + b";" + bytes([checksum(text)])


def decode_information(lines: Iterable[bytes]) -> tuple[dict[str, str], int]:
    """Return the values by key of VV, PP or II lines, and how many lines were damaged.

    Both customs are accepted: the sum with and without the semicolon.
    """
    values, damaged = {}, 0
    for line in lines:
        text, total = line[:-1], line[-1:]
        key, colon, value = text.rstrip(b";").partition(b":")
        if colon and total and total[0] in (checksum(text), checksum(text[:-1])):
            values[key.decode("latin-1")] = value.decode("latin-1")
        else:
            damaged += 1
    return values, damaged


class ReplyFramer:
    """Cuts what a sensor sends into replies; what is none is skipped and counted."""

    def __init__(self) -> None:
        self.replies = 0
        self.skipped_bytes = 0
        self._buffer = StampedBuffer()
        self._searched = 0

    @property
    def pending(self) -> int:
        """How many bytes wait for the rest of their reply, `MAX_REPLY` at most."""
        return len(self._buffer.data)

    def feed(self, data: bytes, stamp_ns: int) -> list[Reply]:
        """Return the replies that `data`, received at `stamp_ns`, completes."""
        self._buffer.append(data, stamp_ns)
        replies: list[Reply] = []
        while (end := self._buffer.data.find(b"\n\n", self._searched)) >= 0:
            replies += self._in_block(bytes(self._buffer.data[:end]))
            self._drop(end + 2)
        self._searched = max(0, self.pending - 1)
        if self.pending > MAX_REPLY:
            self.skipped_bytes += self.pending - LINE
            self._drop(self.pending - LINE)
        return replies

    def _drop(self, count: int) -> None:
        self._buffer.drop(count)
        self._searched = 0

    def _in_block(self, block: bytes) -> list[Reply]:
        """Find the replies before an empty line: one, none, or more where an end was lost."""
        lines = block.split(b"\n")
        starts = [i for i in range(len(lines) - 1) if _is_start(lines[i], lines[i + 1])]
        begins = [0]  # of each line
        for line in lines:
            begins.append(begins[-1] + len(line) + 1)
        self.skipped_bytes += begins[starts[0]] if starts else len(block)
        replies = []
        for first, after in pairwise([*starts, len(lines)]):
            status = lines[first + 1]
            reply = Reply(
                lines[first].rstrip(b"\r"),
                (status[:-1] if len(status) == 3 else status).decode("ascii"),
                tuple(lines[first + 2 : after]),
                self._buffer.stamp(begins[after]),
                self._buffer.stamp(begins[first]),
            )
            replies.append(reply)
        self.replies += len(replies)
        return replies


def _is_start(echo: bytes, status: bytes) -> bool:
    """Whether two lines open a reply; SCIP 1.1 answers with one character and no sum."""
    command = decode_command(echo.rstrip(b"\r"))
    if command is None or command.symbol not in _SYMBOLS:
        return False
    if len(status) == 3:
        return is_sound(status) and status.isascii()
    return status in (b"0", b"E")


class CommandFramer:
    """Cuts what a client sends into lines, for simulated sensors; CR, LF and CRLF end them."""

    def __init__(self) -> None:
        self.skipped_bytes = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that `data` completes; empty ones mean nothing."""
        self._buffer += data.replace(b"\r", b"\n")
        *lines, rest = bytes(self._buffer).split(b"\n")
        self.skipped_bytes += max(0, len(rest) - MAX_COMMAND)
        self._buffer = bytearray(rest[-MAX_COMMAND:])
        return [line for line in lines if line]
