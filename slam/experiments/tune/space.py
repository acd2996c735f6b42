"""What `slam tune` may change: settings with bounds, and elements of settings that are lists."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from optuna.trial import Trial
from pydantic import ValidationError

from slam.mapping.config import SlamConfig
from slam.runs.config_file import describe, known_keys, nearest
from slam.runs.errors import ConfigError

Number = int | float


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number to be found, between two bounds."""

    name: str  # section.key, or section.key.N for the Nth element of a list, from 1
    low: Number
    high: Number
    log: bool  # whether equal ratios, not equal steps, are equally likely

    def suggest(self, trial: Trial) -> Number:
        """A value for a trial; whole where the setting is."""
        if isinstance(self.low, int) and isinstance(self.high, int):
            return trial.suggest_int(self.name, self.low, self.high, log=self.log)
        return trial.suggest_float(self.name, self.low, self.high, log=self.log)


def parse_parameter(text: str, config: SlamConfig) -> Parameter:
    """Read `section.key=low:high[:log]`.

    Raises:
        ConfigError: the text has another form, or the setting is unknown or not a number.
    """
    name, _, bounds = text.partition("=")
    low, _, rest = bounds.partition(":")
    high, _, scale = rest.partition(":")
    try:
        a, b = float(low), float(high)
    except ValueError as error:
        raise _malformed(text) from error
    if scale not in ("", "log") or not (math.isfinite(a + b) and a < b):
        raise _malformed(text)
    if scale and a <= 0:
        raise ConfigError(f"--param {text!r}: a logarithmic scale needs bounds above 0")
    known = _value(config, name)
    if isinstance(known, bool) or not isinstance(known, int | float):
        raise ConfigError(f"--param {text!r}: {name} is not a number (it is {known!r})")
    if isinstance(known, int):
        if not (a.is_integer() and b.is_integer()):
            raise ConfigError(f"--param {text!r}: {name} takes whole numbers")
        return Parameter(name, int(a), int(b), bool(scale))
    return Parameter(name, a, b, bool(scale))


def parse_parameters(texts: Sequence[str], config: SlamConfig) -> tuple[Parameter, ...]:
    """Read all; raises like `parse_parameter`, and if one is named twice or there is none."""
    parameters = tuple(parse_parameter(text, config) for text in texts)
    if not parameters:
        raise ConfigError("nothing to tune: name a setting with --param section.key=low:high")
    names = [parameter.name for parameter in parameters]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"--param {name}: given more than once")
    return parameters


def values_of(config: SlamConfig, parameters: Sequence[Parameter]) -> dict[str, Number]:
    """What the configuration has at each parameter."""
    return {parameter.name: _value(config, parameter.name) for parameter in parameters}


def with_values(config: SlamConfig, values: Mapping[str, Number]) -> SlamConfig:
    """The configuration with other numbers at some of its settings.

    Raises:
        ConfigError: they are out of range, or do not go together.
    """
    data = config.model_dump()
    for name, value in values.items():
        *sections, last = name.split(".")
        holder: Any = data
        for section in sections:
            if isinstance(holder[section], tuple):
                holder[section] = list(holder[section])
            holder = holder[section]
        holder[int(last) - 1 if isinstance(holder, list) else last] = value
    try:
        return SlamConfig.model_validate(data)
    except ValidationError as error:
        raise ConfigError(describe(error)) from error


def _value(config: SlamConfig, name: str) -> Any:
    """What stands at a dotted name.

    Raises:
        ConfigError: there is no such setting.
    """
    value: Any = config.model_dump()
    for part in name.split("."):
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, tuple) and part.isdecimal() and 1 <= int(part) <= len(value):
            value = value[int(part) - 1]
        else:
            raise ConfigError(f"unknown setting {name}{nearest(name, known_keys(SlamConfig))}")
    return value


def _malformed(text: str) -> ConfigError:
    return ConfigError(
        f"--param {text!r}: expected section.key=low:high or section.key=low:high:log"
    )
