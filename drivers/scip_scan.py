"""Scans and parameters of SCIP sensors: what to ask for, and what the numbers mean."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from slam.drivers.scip_protocol import Reply, data_lines, decode_number, encode_number, joined_data

Integers = NDArray[np.int32]
ScanSymbol = Literal["GD", "GE", "GS", "MD", "ME", "MS"]

SCAN_SYMBOLS: tuple[str, ...] = get_args(ScanSymbol)
NO_RETURN = 65533  # newer firmware, in some drivers (docs/devices.md, section 4.5)
_TIMESTAMP = 4  # characters
_PARAMETERS = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """What a sensor says about itself in PP (section 4.4)."""

    model: str
    range_min_mm: int  # DMIN: smaller numbers are error codes
    range_max_mm: int  # DMAX
    steps_per_turn: int  # ARES
    first_step: int  # AMIN
    last_step: int  # AMAX
    front_step: int  # AFRT
    rpm: int  # SCAN

    def __post_init__(self) -> None:
        """Refuse what no sensor can be: it would be divided by."""
        if self.steps_per_turn <= 0 or self.rpm <= 0 or self.first_step > self.last_step:
            raise ValueError(f"these are no sensor's parameters: {self}")

    @property
    def sweep_s(self) -> float:
        """Seconds a turn takes."""
        return 60.0 / self.rpm

    @property
    def step_s(self) -> float:
        """Seconds from one step to the next."""
        return self.sweep_s / self.steps_per_turn

    @property
    def step_rad(self) -> float:
        """Angle from one step to the next."""
        return 2.0 * math.pi / self.steps_per_turn

    def bearing(self, step: float) -> float:
        """Return the direction of a step, rad, anticlockwise from straight ahead."""
        return (step - self.front_step) * self.step_rad

    def nearest_step(self, bearing: float) -> int:
        """Return the step nearest to a direction (rad) that the sensor looks at."""
        step = self.front_step + round(bearing / self.step_rad)
        return min(max(step, self.first_step), self.last_step)


def parameters_from(values: dict[str, str]) -> SensorParameters | None:
    """Build the parameters from the lines of PP, None if one is missing or no number."""
    try:
        numbers = [int(values[key]) for key in _PARAMETERS]
        return SensorParameters(values["MODL"], *numbers)
    except (KeyError, ValueError):
        return None


@dataclass(frozen=True, slots=True)
class ScanRequest:
    """Which steps to report, and how often (section 4.1)."""

    symbol: ScanSymbol
    start: int
    end: int
    cluster: int = 1  # steps joined into one value, their smallest
    skip: int = 0  # scans left out between two reports; MD, ME, MS only
    count: int = 0  # scans to send, 0 for no end; MD, ME, MS only

    @property
    def streams(self) -> bool:
        """Whether reports come without being asked for again."""
        return self.symbol[0] == "M"

    @property
    def characters(self) -> int:
        """Characters of one range."""
        return 2 if self.symbol[1] == "S" else 3

    @property
    def with_intensity(self) -> bool:
        """Whether an intensity follows each range."""
        return self.symbol[1] == "E"

    @property
    def values(self) -> int:
        """Ranges in one report."""
        return -(-(self.end - self.start + 1) // max(self.cluster, 1))

    def encode(self) -> bytes:
        """Return the command line without its end."""
        steps = f"{self.symbol}{self.start:04}{self.end:04}{self.cluster:02}"
        return (f"{steps}{self.skip}{self.count:02}" if self.streams else steps).encode()

    def is_answered_by(self, echo: bytes) -> bool:
        """Whether an echo belongs here: its last two digits count down (section 4.2)."""
        mine = self.encode()
        return echo[:13] == mine[:13] and len(echo) >= len(mine)


def decode_request(echo: bytes) -> ScanRequest | None:
    """Return the request in a command or its echo, None if it is of another kind."""
    text = echo.partition(b";")[0].decode("latin-1")
    symbol, digits = text[:2], text[2:]
    if symbol not in SCAN_SYMBOLS or not digits.isdecimal():
        return None
    if len(digits) != (13 if symbol[0] == "M" else 10):
        return None
    numbers = [int(digits[:4]), int(digits[4:8]), int(digits[8:10])]
    if symbol[0] == "M":
        numbers += [int(digits[10]), int(digits[11:13])]
    return ScanRequest(symbol, *numbers)  # type: ignore[arg-type]  # checked above


@dataclass(frozen=True, eq=False, slots=True)
class RawScan:
    """One report, in the sensor's own units."""

    request: ScanRequest  # with `count` the scans still to come
    timestamp: int  # ms, 24 bits, when the sweep passed step 0
    distances: Integers  # mm, or error codes below DMIN
    intensities: Integers | None


def decode_scan(reply: Reply) -> RawScan | None:
    """Return the scan in a reply, None if any line of it is damaged or missing.

    The sums have six bits only, so length and characters are checked as well.
    """
    request = decode_request(reply.echo)
    if request is None or len(reply.lines) < 2 or len(reply.lines[0]) != _TIMESTAMP + 1:
        return None
    stamp, text = joined_data(reply.lines[:1]), joined_data(reply.lines[1:])
    if stamp is None or text is None:
        return None
    columns = 2 if request.with_intensity else 1
    if len(text) != request.values * request.characters * columns:
        return None
    values = decode_values(text, request.characters)
    try:
        timestamp = decode_number(stamp)
    except ValueError:
        return None
    if values is None:
        return None
    table = values.reshape(-1, columns)
    return RawScan(request, timestamp, table[:, 0], table[:, 1] if columns == 2 else None)


def decode_values(text: bytes, characters: int) -> Integers | None:
    """Return the numbers in encoded data, None if a character is none of SCIP's."""
    sextets = np.frombuffer(text, np.uint8).astype(np.int32) - 0x30
    if sextets.size and not (sextets.min() >= 0 and sextets.max() < 64):
        return None
    weights = (64 ** np.arange(characters - 1, -1, -1)).astype(np.int32)
    return np.asarray(sextets.reshape(-1, characters) @ weights, np.int32)


def encode_scan(
    timestamp: int, distances: Integers, characters: int, intensities: Integers | None = None
) -> list[bytes]:
    """Return the lines of a report behind its status: timestamp and data, with sums.

    Ranges that do not fit into their characters become the largest that does.
    """
    columns = [distances] if intensities is None else [distances, intensities]
    numbers = np.clip(np.stack(columns, axis=1).ravel(), 0, 64**characters - 1)
    shifts = 6 * np.arange(characters - 1, -1, -1)
    text = ((numbers[:, None] >> shifts & 0x3F) + 0x30).astype(np.uint8).tobytes()
    return [*data_lines(encode_number(timestamp % (1 << 24), _TIMESTAMP)), *data_lines(text)]


def ranges_m(
    distances: Integers, parameters: SensorParameters, reach_m: float
) -> NDArray[np.float32]:
    """Turn reported distances into metres, with inf and nan for what is none (section 4.5).

    Nothing came back (inf) is: more than DMAX or `reach_m`, and code 1 of the UTM, UXM and
    UST families.  Other numbers below DMIN are errors of a kind that says nothing about the
    space in front of the sensor: nan.
    """
    ranges = (distances * np.float32(0.001)).astype(np.float32)
    far = (distances > parameters.range_max_mm) | (ranges > reach_m) | (distances == NO_RETURN)
    ranges[distances < parameters.range_min_mm] = np.nan
    if parameters.model.startswith(("UTM", "UXM", "UST")):
        far |= distances == 1
    ranges[far] = np.inf
    return ranges
