"""The settings of a batch: every combination of the values that `--set` names."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from slam.mapping.config import SlamConfig
from slam.runs.config_file import known_keys, load_config, nearest
from slam.runs.errors import ConfigError

_OPEN, _CLOSE = "[{", "]}"


@dataclass(frozen=True, slots=True)
class GridPoint:
    """One combination; without a configuration it cannot be run, and the reason says why."""

    values: tuple[str, ...]  # as they were written, one for each name of the grid
    config: SlamConfig | None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Grid:
    """All combinations, the last setting changing fastest."""

    names: tuple[str, ...]
    points: tuple[GridPoint, ...]

    def label(self, point: GridPoint) -> str:
        """A combination for people."""
        pairs = zip(self.names, point.values, strict=True)
        return " ".join(f"{name}={value}" for name, value in pairs) or "as configured"


def make_grid(config: Path | None, settings: Sequence[str]) -> Grid:
    """Read `section.key=a,b,c`, once for each setting; commas within brackets do not count.

    A value that is out of range, or does not go with the others, spoils its own combinations
    only: where two settings limit each other, a grid can hardly do without such.

    Raises:
        ConfigError: the file is not acceptable, a setting is unknown or named twice, or no
            combination is acceptable.
    """
    load_config(config)
    axes = [_axis(text) for text in settings]
    names = tuple(name for name, _ in axes)
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"--set {name}: given more than once; write {name}=a,b,c")
    points = tuple(_point(config, names, values) for values in product(*(v for _, v in axes)))
    if all(point.config is None for point in points):
        raise ConfigError(points[0].reason)
    return Grid(names, points)


def parsed(text: str) -> Any:
    """A value as TOML understands it, or else the text itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _axis(text: str) -> tuple[str, list[str]]:
    name, equals, values = text.partition("=")
    name = name.strip()
    if not equals or not name:
        raise ConfigError(f"--set {text!r}: expected section.key=value or section.key=a,b,c")
    known = known_keys(SlamConfig)
    if name not in known:
        raise ConfigError(f"--set {text!r}: unknown setting {name}{nearest(name, known)}")
    return name, list(_split(values))


def _split(text: str) -> Iterator[str]:
    """Cut at the commas that are in no bracket and no quotes."""
    depth, quote, begin = 0, "", 0
    for k, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter == "," and depth == 0:
            yield text[begin:k].strip()
            begin = k + 1
        else:
            depth += (letter in _OPEN) - (letter in _CLOSE)
    yield text[begin:].strip()


def _point(config: Path | None, names: Sequence[str], values: tuple[str, ...]) -> GridPoint:
    overrides = [f"{name}={value}" for name, value in zip(names, values, strict=True)]
    try:
        return GridPoint(values, load_config(config, overrides))
    except ConfigError as error:
        return GridPoint(values, None, str(error))
